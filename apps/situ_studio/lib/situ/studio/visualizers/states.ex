defmodule Situ.Studio.Visualizers.States do
  @moduledoc false
  # Draws states that hold until the next message: booleans, atoms, and maps of them with a lane
  # per key.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Visualizer, StreamOverview, StreamReader}
  alias Situ.Studio.Draw.{GapDetection, Segments, SummaryLanes}

  @impl true
  def about,
    do: %Visualizer{
      id: "states",
      title: "States",
      panel: :lanes,
      shapes: [:boolean, :state, :states]
    }

  # If there are too many messages to distinguish, the source's summary is drawn. Parts of messages have no summary.
  @impl true
  def window(source, channel, %{stream: stream, path: []} = spec, from, to, bin) do
    case StreamOverview.fetch_summary(source, stream, from, to, max(div(to - from, bin), 2)) do
      {:ok, summary} ->
        later = message_time(StreamReader.next_after(source, stream, to))
        newest = List.wrap(message_time(StreamReader.latest_at(source, stream, to)))
        before = message_time(StreamReader.latest_at(source, stream, from - 1))

        summary
        |> SummaryLanes.from_summary(later)
        |> Segments.remove_gaps(
          GapDetection.find_gaps(extend_counts(summary.counts, before, later))
        )
        |> Segments.segments_frame(channel, bin, Enum.map(newest, &%{originating_time: &1}), true)

      :none ->
        Segments.window(source, channel, spec, from, to, bin)

      error ->
        error
    end
  end

  def window(source, channel, spec, from, to, bin),
    do: Segments.window(source, channel, spec, from, to, bin)

  # A gap may extend beyond the window. The first bin is complete and may therefore contain the message before it.
  defp extend_counts([{first, _} | _] = counts, before, later) do
    before = if before != nil and before < first, do: [{before, 1}], else: []
    before ++ counts ++ if(later, do: [{later, 1}], else: [])
  end

  defp message_time({:ok, message}), do: message.originating_time
  defp message_time(_), do: nil
end
