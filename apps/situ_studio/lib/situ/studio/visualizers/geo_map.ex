defmodule Situ.Studio.Visualizers.GeoMap do
  @moduledoc false
  # Draws positions on the Earth (`Situ.GeoPoint`, or maps with latitude and longitude) on a map:
  # the track of the whole recording, and the position at the cursor. `Situ.GeoPoint.from_data/1`
  # lists the values that are positions.
  @behaviour Situ.Studio.Visualizer

  alias Situ.GeoPoint
  alias Situ.Studio.{Frame, ValuePath, Visualizer, StreamReader}
  alias Situ.Studio.Draw.{Bins, WindowMessages}
  alias Situ.Studio.Visualizers.SharedOptions

  # The maximum number of points drawn of a track.
  @most 5_000

  @impl true
  def about do
    options =
      SharedOptions.visible() ++
        SharedOptions.color() ++
        [
          width: [type: {:range, 0.5, 12}, title: "Width", default: 3],
          points: [type: :boolean, title: "Points", default: false],
          accuracy: [type: :boolean, title: "Accuracy", default: true]
        ]

    %Visualizer{id: "map", title: "Map", panel: :map, shapes: [:place], options: options}
  end

  @impl true
  def window(source, channel, spec, from, to, _bin) do
    with {:ok, messages, all?} <- read_messages(source, spec.stream, from, to) do
      places = for m <- messages, {:ok, p} <- [fetch_position(m.data, spec.path)], do: {m, p}
      line = fn value -> for {m, p} <- places, do: Bins.point(m.originating_time, value.(p)) end

      lines = [
        {"latitude", line.(& &1.latitude)},
        {"longitude", line.(& &1.longitude)}
      ]

      Frame.lines(channel, lines, all?, sampled: not all?)
    end
  end

  defp read_messages(source, stream, from, to) do
    case WindowMessages.fetch_within(source, stream, from, to) do
      {:ok, messages, true} when length(messages) > @most ->
        every = div(length(messages) - 1, @most) + 1
        {:ok, Enum.take_every(messages, every) ++ Enum.take(messages, -1), false}

      {:ok, messages, true} ->
        {:ok, messages, true}

      {:ok, _, false} ->
        with {:ok, rows} <- StreamReader.sample_messages(source, stream, from, to, @most),
             do: {:ok, Enum.map(rows, &elem(&1, 1)), false}

      error ->
        error
    end
  end

  defp fetch_position(data, path) do
    with {:ok, data} <- ValuePath.fetch(data, path), do: GeoPoint.from_data(data)
  end

  @impl true
  def instant(channel, data, message) do
    case GeoPoint.from_data(data) do
      {:ok, place} ->
        Frame.json(channel, message.originating_time, %{
          "latitude" => place.latitude,
          "longitude" => place.longitude,
          "height" => place.height,
          "accuracy" => GeoPoint.horizontal_accuracy(place)
        })

      :error ->
        {:error, "this message does not contain a position: it needs a latitude and a longitude"}
    end
  end
end
