defmodule Situ.Bridge.Psi.StoreScan do
  @moduledoc false
  # Scans the data of a store once and records the position of every message in every stream: 28 packed bytes each.
  alias Situ.Bridge.Psi.{Blocks, Bytes, Files}
  alias Situ.Bridge.Psi.Catalog.Entry

  defmodule Track do
    @moduledoc false
    # The messages of one stream in order of time. `positions` holds 28 bytes for each message.
    defstruct positions: "",
              count: 0,
              size: 0,
              latency: 0,
              first: nil,
              last: nil,
              first_creation: nil,
              last_creation: nil

    @type t :: %__MODULE__{}

    @row_bytes 28

    @doc "Returns the position of the message with this ordinal."
    def position_at(%{positions: positions}, ordinal) do
      <<large::1, extent::31, at::64, length::32, time::signed-96>> =
        binary_part(positions, ordinal * @row_bytes, @row_bytes)

      %{
        file: if(large == 1, do: :large, else: :data),
        extent: extent,
        at: at,
        length: length,
        time: time
      }
    end

    @doc "Returns the ordinal of the first message at or after `time`."
    def seek(track, time), do: search_time(track, time, 0, track.count)

    defp search_time(_track, _time, low, high) when low >= high, do: low

    defp search_time(track, time, low, high) do
      middle = div(low + high, 2)

      if position_at(track, middle).time < time,
        do: search_time(track, time, middle + 1, high),
        else: search_time(track, time, low, middle)
    end

    @doc false
    def pack_position(large?, extent, at, length, time),
      do: <<if(large?, do: 1, else: 0)::1, extent::31, at::64, length::32, time::signed-96>>
  end

  # The sequence number of the message that closes a stream; it has no data.
  @closing 0x7FFF_FFFF

  @doc "Scans all streams. Returns their tracks by stream id, and sentences that describe the damage found."
  @spec scan_store(Path.t(), String.t(), %{integer() => Entry.t()}) ::
          {%{integer() => Track.t()}, [String.t()]}
  def scan_store(folder, name, entries) do
    large = Files.extent_sizes(folder, name, :large)
    indexed = for {id, entry} <- entries, Entry.indexed?(entry), into: MapSet.new(), do: id
    acc = %{messages: %{}, large: MapSet.new(), indexed: indexed, timeless: 0}

    {acc, damage} = Blocks.reduce({folder, name, :data}, 48, acc, &add_message/2)
    {complete, lost_count} = complete_large_blocks(folder, name, large, acc.large)

    {tracks, duplicates} =
      Enum.map_reduce(acc.messages, 0, fn {id, messages}, duplicates ->
        {track, duplicate_count} = build_track(messages, complete)
        {{id, track}, duplicates + duplicate_count}
      end)

    {Map.new(tracks), report_losses(lost_count, duplicates, acc.timeless) ++ damage}
  end

  defp report_losses(lost_count, duplicates, timeless) do
    for {n, sentence} <- [
          {timeless, "messages have an invalid time and are left out"},
          {lost_count, "messages have lost their payload in the files for large messages"},
          {duplicates,
           "messages have the same time as another message of their stream and are left out"}
        ],
        n > 0,
        do: "#{n} #{sentence}"
  end

  defp add_message(
         {extent, at, length,
          <<id::little-signed-32, seq::little-signed-32, time::little-64, created::little-64,
            rest::binary>>},
         acc
       )
       when seq != @closing do
    times = {Bytes.parse_time(time), Bytes.parse_time(created)}

    cond do
      not (Bytes.valid_time?(time) and Bytes.valid_time?(created)) ->
        %{acc | timeless: acc.timeless + 1}

      MapSet.member?(acc.indexed, id) ->
        add_large_message(id, times, rest, acc)

      true ->
        put_position(acc, id, {times, {:data, extent, at, length}})
    end
  end

  defp add_message(_block, acc), do: acc

  # A message of an indexed stream has a position in the files for large messages instead of data: an extent (as an
  # offset from the smallest integer) and a byte position.
  defp add_large_message(
         id,
         times,
         <<extent::little-signed-32, at::little-signed-32, _::binary>>,
         acc
       )
       when extent < 0 and at >= 0 do
    position = {extent + 0x8000_0000, at}
    acc = %{acc | large: MapSet.put(acc.large, position)}
    {extent, at} = position
    put_position(acc, id, {times, {:large, extent, at}})
  end

  defp add_large_message(_id, _times, _rest, acc), do: acc

  defp put_position(acc, id, message),
    do: %{acc | messages: Map.update(acc.messages, id, [message], &[message | &1])}

  # Finds the complete large messages. The result maps `{extent, position of the block}` to
  # `{extent, position of the payload, length}`.
  defp complete_large_blocks(folder, name, sizes, blocks) do
    context = %{folder: folder, name: name, sizes: sizes}

    complete =
      for {extent, positions} <- Enum.group_by(blocks, &elem(&1, 0), &elem(&1, 1)),
          {at, block} <- complete_blocks(context, extent, Enum.sort(positions)),
          into: %{},
          do: {{extent, at}, block}

    {complete, MapSet.size(blocks) - map_size(complete)}
  end

  defp complete_blocks(context, extent, positions) do
    for {at, length} <- read_lengths(context, extent, positions),
        block = find_block(context, extent, at, length),
        do: {at, block}
  end

  defp find_block(context, extent, at, length) when length >= 24,
    do: if(at + 4 + length <= context.sizes[extent], do: {extent, at + 4, length})

  # The message did not fit at the end of this extent, so it is at the beginning of the next extent.
  defp find_block(context, extent, _at, next) when next < 0 and -next > extent do
    with [{0, length}] when length >= 24 <- read_lengths(context, -next, [0]),
         do: find_block(context, -next, 0, length),
         else: (_ -> nil)
  end

  defp find_block(_context, _extent, _at, _length), do: nil

  defp read_lengths(%{sizes: sizes}, extent, _positions) when not is_map_key(sizes, extent),
    do: []

  defp read_lengths(context, extent, positions) do
    path = Files.extent_path(context.folder, context.name, :large, extent)

    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]),
         result = :file.pread(file, Enum.map(positions, &{&1, 4})),
         :ok <- :file.close(file),
         {:ok, lengths} <- result do
      for {at, <<length::little-signed-32>>} <- Enum.zip(positions, lengths), do: {at, length}
    else
      _ -> []
    end
  end

  # Messages are found in the order in which they were written. Within a stream, this is normally the order of time.
  defp build_track(messages, complete) do
    messages =
      messages
      |> Enum.reverse()
      |> Enum.flat_map(&pack_message(&1, complete))
      |> Enum.sort_by(&elem(&1, 0))

    unique = Enum.dedup_by(messages, &elem(&1, 0))

    {Enum.reduce(unique, %Track{}, &count_message/2) |> put_positions(unique),
     length(messages) - length(unique)}
  end

  defp pack_message({{time, created}, {:data, extent, at, length}}, _complete),
    do: [{time, created, length, Track.pack_position(false, extent, at, length, time)}]

  defp pack_message({{time, created}, {:large, extent, at}}, complete) do
    case complete do
      %{{^extent, ^at} => {extent, at, length}} ->
        [{time, created, length, Track.pack_position(true, extent, at, length, time)}]

      _ ->
        []
    end
  end

  defp count_message({time, created, length, _position}, track) do
    %{
      track
      | count: track.count + 1,
        size: track.size + length - 24,
        latency: track.latency + created - time,
        first: track.first || time,
        last: time,
        first_creation: track.first_creation || created,
        last_creation: created
    }
  end

  defp put_positions(track, unique),
    do: %{track | positions: for(m <- unique, into: "", do: elem(m, 3))}
end
