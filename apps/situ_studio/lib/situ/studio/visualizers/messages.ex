defmodule Situ.Studio.Visualizers.Messages do
  @moduledoc false
  # Draws a mark at the time of each message.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, Visualizer, StreamReader}
  alias Situ.Studio.Visualizers.SharedOptions

  @rows 20_000

  @impl true
  def about do
    options = SharedOptions.color()
    %Visualizer{id: "messages", title: "Messages", panel: :lanes, shapes: :any, options: options}
  end

  @impl true
  def window(source, channel, %{stream: stream}, from, to, _bin) do
    with {:ok, rows, all} <- StreamReader.read_marks(source, stream, from, to, @rows),
         do: Frame.marks(channel, rows, all == :all)
  end
end
