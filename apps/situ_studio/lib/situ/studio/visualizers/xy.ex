defmodule Situ.Studio.Visualizers.XY do
  @moduledoc false
  # Plots numbers against each other: the panel's first stream is x and the others are y, at the
  # times of their messages in the view. The data of each stream is the same as for a line.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.Visualizer
  alias Situ.Studio.Visualizers.{Line, SharedOptions}

  @impl true
  def about do
    %Visualizer{
      id: "xy",
      title: "XY plot",
      panel: :xy,
      shapes: [:signal],
      options: SharedOptions.visible() ++ SharedOptions.color()
    }
  end

  @impl true
  defdelegate window(source, channel, spec, from, to, bin), to: Line
end
