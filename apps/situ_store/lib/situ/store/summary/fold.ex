defmodule Situ.Store.Summary.Fold do
  @moduledoc false
  # Summarizes by reading every message, for readers without a pyramid and as the reference for readers that have one.
  #
  # Stores keep bins for streams of any type (levels 65 to 126), because above 200,000 messages a
  # timeline without them could draw only a sample. A bin of 32 messages takes 3 bytes if it has
  # only a count, and about 10 bytes for booleans. Writing costs 15 to 60 ns more per message, and
  # about 100 ns per key of a map. A property test compares the bins with this module.
  import Bitwise
  alias Situ.Recording
  alias Situ.Store.{Query, StreamInfo, Summary}
  alias Situ.Store.Summary.Bins

  @most_keys 64
  @most_states 256
  @longest 64
  @other :"$other"

  @spec fold_numbers(Recording.t(), StreamInfo.t(), integer(), integer(), non_neg_integer()) ::
          {:ok, pos_integer(), [Summary.bin()]} | {:error, Situ.Error.t()}
  def fold_numbers(store, info, from, to, level) do
    bins =
      store
      |> Query.messages(info, from: from, to: to)
      |> Stream.flat_map(&Bins.message_points/1)
      |> Stream.filter(fn {time, _, _, _, _} -> time >= from and time <= to end)
      |> Bins.fold_points(level)

    {:ok, bsl(1, level), bins}
  rescue
    error in Situ.Error -> {:error, error}
  end

  @spec fold_tracks(
          Recording.t(),
          StreamInfo.t(),
          integer(),
          integer(),
          non_neg_integer(),
          integer()
        ) ::
          {:ok, [{integer(), pos_integer()}], [{term(), Summary.track()}]}
          | {:error, Situ.Error.t()}
  def fold_tracks(store, info, from, to, level, most) do
    span = {Bins.bin_start(from, level), Bins.bin_start(to, level) + bsl(1, level) - 1}

    with {:ok, before} <- Query.latest_at(store, info, from) do
      messages = Query.messages(store, info, from: elem(span, 0), to: elem(span, 1))

      seed =
        for %{data: data, originating_time: time} <- [before],
            part <- message_parts(data),
            do: {time, part}

      {counts, tracks} = collect_values(messages, level, seed)

      {:ok, counts,
       tracks |> drop_mixed_numbers() |> Enum.map(&build_track(&1, {from, to}, most))}
    end
  rescue
    error in Situ.Error -> {:error, error}
  end

  # Collects `{time, value}` of each message for each track, latest first.
  defp collect_values(messages, level, seed) do
    {counts, order, values} =
      Enum.reduce(messages, {[], [], %{}}, fn %{originating_time: time, data: data},
                                              {counts, order, values} ->
        {order, values} =
          Enum.reduce(message_parts(data), {order, values}, &put_value(&1, time, &2))

        {increment_bin(counts, Bins.bin_start(time, level)), order, values}
      end)

    seeds = Map.new(seed, fn {time, {name, value}} -> {name, {time, value}} end)

    tracks =
      for name <- Enum.reverse(order), do: {name, level, Enum.reverse(values[name]), seeds[name]}

    {Enum.reverse(counts), tracks}
  end

  # Omits numbers in a stream that also contains booleans, whose signal would otherwise mix with them.
  defp drop_mixed_numbers(tracks) do
    truths? =
      Enum.any?(tracks, fn {name, _, values, _} ->
        name == {nil, :state} and Enum.any?(values, fn {_, value} -> is_boolean(value) end)
      end)

    if truths?,
      do: Enum.reject(tracks, fn {name, _, _, _} -> name == {nil, :number} end),
      else: tracks
  end

  defp put_value({name, value}, time, {order, values}) do
    case values do
      %{^name => list} -> {order, %{values | name => [{time, value} | list]}}
      _ -> {[name | order], Map.put(values, name, [{time, value}])}
    end
  end

  defp increment_bin([{start, n} | rest], start), do: [{start, n + 1} | rest]
  defp increment_bin(counts, start), do: [{start, 1} | counts]

  defp build_track({{key, :number}, level, values, _seed}, _span, _most) do
    points = for {time, x} <- values, do: {time, x, x, x, 1}
    {key, {:numbers, Bins.fold_points(points, level)}}
  end

  defp build_track({{key, :state}, level, values, seed}, {from, to}, most) do
    within = Enum.filter(values, fn {time, _} -> time > from and time <= to end)
    changes = Enum.dedup_by(List.wrap(seed) ++ within, &elem(&1, 1))

    if length(changes) - length(List.wrap(seed)) <= most,
      do: {key, {:changes, changes}},
      else: {key, {:states, count_states(values, level)}}
  end

  defp count_states(values, level) do
    known =
      values |> Enum.map(&elem(&1, 1)) |> Enum.uniq() |> Enum.take(@most_states) |> MapSet.new()

    values = for {time, v} <- values, do: {time, if(v in known, do: v, else: @other)}

    for [{time, _} | _] = bin <- Enum.chunk_by(values, fn {time, _} -> bsr(time, level) end) do
      tally = bin |> Enum.map(&elem(&1, 1)) |> Enum.frequencies()
      order = bin |> Enum.map(&elem(&1, 1)) |> Enum.uniq()
      {_, last} = List.last(bin)

      {Bins.bin_start(time, level), last,
       Enum.sort_by(for(v <- order, do: {v, tally[v]}), &(-elem(&1, 1)))}
    end
  end

  @doc "Splits the data of a message into the values of its tracks: `{{key, :number | :state}, value}`."
  @spec message_parts(term()) :: [{{term(), :number | :state}, term()}]
  def message_parts(%module{} = data) do
    if Situ.Codec.implemented_by?(module),
      do: [],
      else: data |> Map.from_struct() |> field_parts()
  end

  def message_parts(data) when is_map(data), do: field_parts(data)

  def message_parts(data) do
    with {kind, value} <- classify_value(data), do: [{{nil, kind}, value}], else: (nil -> [])
  end

  defp field_parts(map) when map_size(map) > @most_keys, do: []

  defp field_parts(map) do
    for {key, data} <- map,
        is_atom(key) or is_integer(key) or (is_binary(key) and byte_size(key) <= @longest),
        {kind, value} <- List.wrap(classify_value(data)),
        do: {{key, kind}, value}
  end

  defp classify_value(x) when is_float(x), do: {:number, x}
  defp classify_value(n) when is_integer(n) and abs(n) < 0x8000000000000000, do: {:number, n / 1}
  defp classify_value(state) when is_atom(state), do: {:state, state}

  defp classify_value(text) when is_binary(text) and byte_size(text) <= @longest,
    do: {:state, text}

  defp classify_value(_), do: nil
end
