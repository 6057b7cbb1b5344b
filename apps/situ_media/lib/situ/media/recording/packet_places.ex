defmodule Situ.Media.Recording.PacketPlaces do
  @moduledoc false
  # The places of the video packets of a file, in the order in which a decoder needs them: for each packet, the time
  # of its image, its position and size in the file, its checksum (Adler-32, as ffprobe states it), and whether it is
  # a key frame. With the checksums, bytes that are read from the file are certain to be those that FFmpeg would decode,
  # whatever the container. An hour at 30 images per second takes 2.7 MB.
  # See docs/adr/0189-the-page-decodes-compressed-video.md.

  @bytes 25
  @hidden -1
  # Containers such as Matroska put a few additional bytes before the data of a packet.
  @longest_lead 32

  @type row :: {time :: Situ.Time.t() | nil, key? :: boolean(), size :: pos_integer()}

  @doc """
  Packs the places of packets, last first: `{ticks, key?, hidden?, position, size, checksum}`. `to_time` returns the
  media time of a tick, or `nil` if an image is not shown at this time.

      iex> alias Situ.Media.Recording.PacketPlaces
      iex> places = [{1, false, false, 140, 9, 7}, {-1, true, false, 100, 40, 5}]
      iex> packed = PacketPlaces.pack(places, &if(&1 >= 0, do: &1 * 40))
      iex> {PacketPlaces.shown_count(packed), PacketPlaces.list_rows(packed)}
      {1, [{nil, true, 40}, {40, false, 9}]}
  """
  @spec pack([tuple()], (integer() -> Situ.Time.t() | nil)) :: binary()
  def pack(places, to_time) do
    places
    |> Enum.reverse()
    |> Enum.map(fn {ticks, key?, hidden?, position, size, checksum} ->
      time = if hidden?, do: @hidden, else: to_time.(ticks) || @hidden
      <<time::signed-64, position::64, size::32, checksum::32, if(key?, do: 1, else: 0)::8>>
    end)
    |> IO.iodata_to_binary()
  end

  @doc "Returns the number of packets whose images are shown."
  @spec shown_count(binary()) :: non_neg_integer()
  def shown_count(packed), do: Enum.count(list_rows(packed), &(elem(&1, 0) != nil))

  @doc "Returns the packets as `{time, key?, size}`; the time is `nil` if the image is never shown."
  @spec list_rows(binary()) :: [row()]
  def list_rows(packed) do
    for <<time::signed-64, _position::64, size::32, _checksum::32, key::8 <- packed>>,
      do: {if(time != @hidden, do: time), key == 1, size}
  end

  @doc "Returns the sizes of at most `count` packets; fewer if there are no more."
  @spec list_sizes(binary(), non_neg_integer(), non_neg_integer()) :: [pos_integer()]
  def list_sizes(packed, first, count) do
    from = min(first * @bytes, byte_size(packed))
    bytes = binary_part(packed, from, min(count * @bytes, byte_size(packed) - from))
    for <<_::128, size::32, _::40 <- bytes>>, do: size
  end

  @doc """
  Reads packets from an open file and verifies them. Returns `:mismatch` if the bytes differ from the listed ones.
  """
  @spec read(:file.io_device(), binary(), non_neg_integer(), non_neg_integer()) ::
          {:ok, [binary()]} | :mismatch
  def read(file, packed, first, count) do
    rows =
      for <<_::64, position::64, size::32, checksum::32,
            _::8 <-
              binary_part(packed, first * @bytes, count * @bytes)>>,
          do: {position, size, checksum}

    with [_ | _] <- rows,
         {:ok, lead} <- find_lead(file, hd(rows)),
         spans = for({position, size, _} <- rows, do: {position + lead, size}),
         {:ok, parts} <- :file.pread(file, spans),
         true <-
           rows |> Enum.zip(parts) |> Enum.all?(fn {row, part} -> packet_intact?(part, row) end) do
      {:ok, parts}
    else
      [] -> {:ok, []}
      _ -> :mismatch
    end
  end

  defp packet_intact?(part, {_position, size, checksum}),
    do: is_binary(part) and byte_size(part) == size and packet_checksum(part) == checksum

  defp find_lead(file, {position, size, checksum}) do
    with {:ok, bytes} <- :file.pread(file, position, size + @longest_lead),
         lead when lead != nil <-
           Enum.find(0..@longest_lead, &matches_at?(bytes, &1, size, checksum)) do
      {:ok, lead}
    else
      _ -> :mismatch
    end
  end

  defp matches_at?(bytes, lead, size, checksum),
    do:
      byte_size(bytes) >= lead + size and
        packet_checksum(binary_part(bytes, lead, size)) == checksum

  defp packet_checksum(bytes), do: :erlang.adler32(bytes)
end
