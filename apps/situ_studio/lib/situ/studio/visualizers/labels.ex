defmodule Situ.Studio.Visualizers.Labels do
  @moduledoc "Texts, each shown from its message until the next."
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Draw.Segments, Visualizer}

  @impl true
  def about, do: %Visualizer{id: "labels", title: "Labels", panel: :lanes, shapes: [:text]}

  @impl true
  defdelegate window(source, channel, spec, from, to, bin), to: Segments
end
