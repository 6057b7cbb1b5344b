defmodule Situ.Studio.Visualizers.BrokenPlugin do
  @moduledoc false
  # Replaces a visualizer whose plug-in could not be loaded. Its panel shows the reason.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, Visualizer}

  @impl true
  def about, do: %Visualizer{id: "broken", title: "Broken", panel: :own, shapes: []}

  @impl true
  def instant(_channel, _data, _message, %{spec: %{viz: viz}}), do: {:error, failure_text(viz)}

  @impl true
  def window(_source, channel, %{viz: viz}, _from, _to, _bin),
    do: Frame.error(channel, failure_text(viz))

  defp failure_text(viz), do: "the plug-in #{viz.plugin} is broken: #{viz.problem}"
end
