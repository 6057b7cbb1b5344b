defmodule Situ.Studio.Visualizers.States do
  @moduledoc "What a message says holds until the next: booleans, atoms, and maps of them, a lane for each key."
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Draw.Segments, Visualizer}

  @impl true
  def about,
    do: %Visualizer{
      id: "states",
      title: "States",
      panel: :lanes,
      shapes: [:boolean, :state, :states]
    }

  @impl true
  defdelegate window(source, channel, spec, from, to, bin), to: Segments
end
