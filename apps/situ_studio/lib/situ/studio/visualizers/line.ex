defmodule Situ.Studio.Visualizers.Line do
  @moduledoc false
  # Draws one number over time, from a whole stream or from a part of its messages.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, ValuePath, Visualizer, StreamOverview, Recordings}
  alias Situ.Studio.Draw.{Bins, WindowMessages, Values}
  alias Situ.Studio.Visualizers.SharedOptions

  @points 1_500

  @impl true
  def about do
    options = SharedOptions.visible() ++ SharedOptions.color() ++ SharedOptions.line_style()

    %Visualizer{
      id: "line",
      title: "Line",
      panel: :plot,
      shapes: [:signal, :boolean],
      options: options
    }
  end

  @impl true
  def window(source, channel, %{stream: stream, path: []} = spec, from, to, bin) do
    if Recordings.DerivedStreams.derived_name?(stream),
      do: frame_from_messages(source, channel, spec, from, to, bin),
      else: summary_frame(source, channel, stream, from, to, bin)
  end

  def window(source, channel, spec, from, to, bin),
    do: frame_from_messages(source, channel, spec, from, to, bin)

  @impl true
  def value_at(source, channel, spec, time),
    do: Values.fetch_at(source, channel, spec, time, fn data, _message -> [{"", data}] end)

  defp summary_frame(source, channel, stream, from, to, bin) do
    with {:ok, points, raw?} <- StreamOverview.read_series(source, stream, from, to, bin),
         do: Frame.series(channel, points, raw?)
  end

  # Without a summary in the source, a line is built from the messages. If there are too many, it is built from a
  # sample, which the frame marks.
  defp frame_from_messages(source, channel, spec, from, to, bin) do
    with {:ok, messages, all?} <- WindowMessages.fetch_around(source, spec, from, to) do
      {points, raw?} = messages |> line_points(spec.path) |> Bins.fold_points(bin, @points)
      Frame.series(channel, points, raw?, sampled: not all?)
    end
  end

  @doc """
  Builds the line of the number at `path` in each message. If it is missing or `nil`, the line has a gap.

      iex> messages = for {t, v} <- [{0, %{a: 1}}, {1, %{}}], do: %Situ.Message{data: v, originating_time: t}
      iex> Situ.Studio.Visualizers.Line.line_points(messages, [{:name, "a"}])
      [{0, 1, 1, 1, 1}, {1, nil, nil, nil, 1}]
  """
  @spec line_points([Situ.Message.t()], ValuePath.t()) :: [Bins.point() | Bins.gap()]
  def line_points(messages, path) do
    for message <- messages, point <- message_points(message, path), do: point
  end

  defp message_points(%{data: data, originating_time: time}, path) do
    case ValuePath.fetch(data, path) do
      {:ok, value} -> Bins.value_points(time, value)
      :error -> [Bins.gap(time)]
    end
  end
end
