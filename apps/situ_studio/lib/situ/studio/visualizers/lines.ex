defmodule Situ.Studio.Visualizers.Lines do
  @moduledoc false
  # Draws a line for each key of maps of numbers. If a value is missing or `nil`, its line has a
  # gap.
  @behaviour Situ.Studio.Visualizer

  alias Situ.Studio.{Frame, ValuePath, Visualizer, StreamOverview}
  alias Situ.Studio.Draw.{Bins, Key, WindowMessages, Values}
  alias Situ.Studio.Visualizers.SharedOptions

  @points 1_500

  @type line :: [Bins.point() | Bins.gap()]

  @impl true
  def about do
    options = SharedOptions.visible() ++ SharedOptions.line_style()
    %Visualizer{id: "lines", title: "Lines", panel: :plot, shapes: [:signals], options: options}
  end

  @impl true
  def window(source, channel, %{path: []} = spec, from, to, bin) do
    case StreamOverview.fetch_summary(source, spec.stream, from, to, max(div(to - from, bin), 2)) do
      {:ok, %{tracks: tracks}} -> summary_frame(channel, tracks)
      :none -> frame_from_messages(source, channel, spec, from, to, bin)
      error -> error
    end
  end

  def window(source, channel, spec, from, to, bin),
    do: frame_from_messages(source, channel, spec, from, to, bin)

  @impl true
  def value_at(source, channel, spec, time),
    do: Values.fetch_at(source, channel, spec, time, fn data, _message -> named_values(data) end)

  defp named_values(%module{}) when is_atom(module), do: []
  defp named_values(%{} = map), do: for({key, value} <- map, do: {Key.key_name(key), value})
  defp named_values(_other), do: []

  defp summary_frame(channel, tracks) do
    bins = for {key, {:numbers, bins}} <- tracks, key != nil, into: %{}, do: {key, bins}
    lines = for key <- Key.sort_keys(Map.keys(bins)), do: {Key.key_name(key), bins[key]}
    Frame.lines(channel, lines, false, more: map_size(bins) - length(lines))
  end

  defp frame_from_messages(source, channel, spec, from, to, bin) do
    with {:ok, messages, all?} <- WindowMessages.fetch_around(source, spec, from, to) do
      keys = by_key(messages, spec.path)
      named = sort_named(keys)
      folded = for {name, points} <- named, do: {name, Bins.fold_points(points, bin, @points)}

      raw? = Enum.all?(folded, fn {_, {_, raw?}} -> raw? end)
      lines = for {name, {points, _}} <- folded, do: {name, points}
      more = map_size(keys) - length(named)
      Frame.lines(channel, lines, raw?, sampled: not all?, more: more)
    end
  end

  # Collects the lines that contain numbers, newest point first.
  defp by_key(messages, path) do
    messages
    |> Enum.reduce(%{}, &add_message(&2, &1, path))
    |> Map.filter(fn {_, line} -> Enum.any?(line, &(not Bins.gap?(&1))) end)
  end

  defp sort_named(lines),
    do:
      for(
        key <- Key.sort_keys(Map.keys(lines)),
        do: {Key.key_name(key), Enum.reverse(lines[key])}
      )

  defp add_message(lines, %{data: data, originating_time: time}, path) do
    values =
      case ValuePath.fetch(data, path) do
        {:ok, map} when is_map(map) and not is_struct(map) -> map
        _ -> %{}
      end

    lines
    |> end_missing(values, time)
    |> then(
      &Enum.reduce(values, &1, fn {key, value}, lines -> put_point(lines, key, time, value) end)
    )
  end

  defp put_point(lines, key, time, value) do
    case {Bins.value_points(time, value), lines} do
      {[], _} -> lines
      {[point], %{^key => line}} -> %{lines | key => [point | line]}
      {[point], _} -> Map.put(lines, key, [point])
    end
  end

  # When a key disappears, its line ends with one gap.
  defp end_missing(lines, values, time) do
    Enum.reduce(lines, lines, fn {key, [last | _] = line}, lines ->
      if is_map_key(values, key) or Bins.gap?(last),
        do: lines,
        else: %{lines | key => [Bins.gap(time) | line]}
    end)
  end
end
