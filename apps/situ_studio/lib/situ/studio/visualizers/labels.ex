defmodule Situ.Studio.Visualizers.Labels do
  @moduledoc false
  # Draws texts on a lane, each from its message until the next one.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Draw.Segments, Visualizer}

  @impl true
  def about, do: %Visualizer{id: "labels", title: "Labels", panel: :lanes, shapes: [:text]}

  @impl true
  defdelegate window(source, channel, spec, from, to, bin), to: Segments
end
