defmodule Situ.Link.Wire.DatagramCodec do
  @moduledoc false
  # Splits frames into datagrams of any size, and reassembles them. Pure.
  #
  # A frame is split into segments, one per datagram. A datagram begins with `seq` (64 bits, never
  # used twice with a key). The rest is encrypted and authenticated by AES-128-GCM, under a key
  # that both sides agreed on over their connection:
  #
  # | bits | |
  # |---|---|
  # | 32 | set: the number of the frame |
  # | 16, 16 | number of the segment (from 0), number of segments |
  # | 64 | messages sent in earlier sets |
  # | 32 | messages in this set |
  # | | the segment |
  #
  # The receiver reassembles sets from segments that may arrive in any order, more than once, or
  # never. It gives up an incomplete set when two later ones are complete. Sets are returned in
  # order. The exact number of messages lost before each is known, since every set carries the
  # number of messages sent before it.
  import Situ.BinarySize, only: [pinned_size: 1]

  @header 20
  @tag 16
  @overhead 8 + @tag + @header
  @min @overhead + 1
  @max 65_507
  # `@max_open` limits the incomplete sets, and `@max_later` is the number of later complete sets that ends the wait
  # for one.
  @max_open 16
  @max_later 2

  defmodule Sender do
    @moduledoc false
    defstruct [:key, :size, seq: 0, set: 0, messages: 0]
  end

  defmodule Receiver do
    @moduledoc false
    defstruct [:key, next: 0, messages: 0, sets: %{}]
  end

  @type sender :: %Sender{}
  @type receiver :: %Receiver{}

  @doc "Returns the smallest and the largest size of a datagram in bytes."
  @spec size_range() :: {pos_integer(), pos_integer()}
  def size_range, do: {@min, @max}

  @doc """
  Returns a sender for datagrams of at most `size` bytes.

      iex> alias Situ.Link.Wire.DatagramCodec
      iex> key = <<7::128>>
      iex> sender = DatagramCodec.new_sender(key, 80)
      iex> {[a, b], _} = DatagramCodec.split_frame(sender, "a frame that is longer than its datagrams are", 3)
      iex> receiver = DatagramCodec.new_receiver(key)
      iex> {[], receiver} = DatagramCodec.receive_datagram(receiver, b)
      iex> {[], receiver} = DatagramCodec.receive_datagram(receiver, b)
      iex> {[{0, frame}], _} = DatagramCodec.receive_datagram(receiver, a)
      iex> frame
      "a frame that is longer than its datagrams are"
  """
  @spec new_sender(<<_::128>>, pos_integer()) :: sender()
  def new_sender(<<key::binary-16>>, size) when size in @min..@max,
    do: %Sender{key: key, size: size - @overhead}

  @spec new_receiver(<<_::128>>) :: receiver()
  def new_receiver(<<key::binary-16>>), do: %Receiver{key: key}

  @doc """
  Splits a frame that holds the given number of messages into datagrams.

  A frame that would need more than 65,535 of them is lost, and the list is empty.
  """
  @spec split_frame(sender(), iodata(), non_neg_integer()) :: {[binary()], sender()}
  def split_frame(%Sender{} = sender, frame, messages) do
    parts = frame |> IO.iodata_to_binary() |> split_bytes(sender.size)
    count = length(parts)
    later = %{sender | set: sender.set + 1, messages: sender.messages + messages}

    if count > 0xFFFF do
      {[], later}
    else
      {datagrams, seq} =
        Enum.map_reduce(Enum.with_index(parts), sender.seq, fn {part, number}, seq ->
          head = <<sender.set::32, number::16, count::16, sender.messages::64, messages::32>>
          {encrypt_datagram(sender.key, 0, seq, [head, part]), seq + 1}
        end)

      {datagrams, %{later | seq: seq}}
    end
  end

  defp split_bytes(bytes, size) when byte_size(bytes) <= size, do: [bytes]

  defp split_bytes(bytes, size) do
    <<part::binary-pinned_size(size), rest::binary>> = bytes
    [part | split_bytes(rest, size)]
  end

  @doc "Adds a datagram. Returns the frames it completes, in order, each with the number of messages lost before it."
  @spec receive_datagram(receiver(), binary()) :: {[{non_neg_integer(), binary()}], receiver()}
  def receive_datagram(%Receiver{} = receiver, datagram) do
    with {:ok, <<set::32, number::16, count::16, before::64, messages::32, part::binary>>} <-
           decrypt_datagram(receiver.key, 0, datagram),
         true <- number < count and set >= receiver.next do
      receiver
      |> put_part(set, number, count, {before, messages}, part)
      |> take_complete_frames([])
    else
      # The datagram is from another sender, or it is too late.
      _ -> {[], receiver}
    end
  end

  defp put_part(receiver, set, number, count, counts, part) do
    empty = %{count: count, counts: counts, parts: %{}}
    open = Map.get(receiver.sets, set, empty)

    if open.count == count and open.counts == counts do
      open = %{open | parts: Map.put(open.parts, number, part)}
      limit_open_sets(%{receiver | sets: Map.put(receiver.sets, set, open)})
    else
      receiver
    end
  end

  # Bounds the memory that a sender can claim by beginning many sets without completing them.
  defp limit_open_sets(%{sets: sets} = receiver) when map_size(sets) > @max_open do
    oldest = sets |> Map.keys() |> Enum.min()
    %{receiver | sets: Map.delete(sets, oldest), next: max(receiver.next, oldest + 1)}
  end

  defp limit_open_sets(receiver), do: receiver

  defp take_complete_frames(receiver, frames) do
    done = for {set, open} <- receiver.sets, map_size(open.parts) == open.count, do: set

    case Enum.sort(done) do
      [] ->
        {Enum.reverse(frames), receiver}

      [first | later] ->
        if first == receiver.next or length(later) >= @max_later or none_before?(receiver, first),
          do: receiver |> take_set(first, frames),
          else: {Enum.reverse(frames), receiver}
    end
  end

  # Before the first set there is nothing to wait for, unless segments of an earlier set have arrived.
  defp none_before?(%{next: 0, sets: sets}, first),
    do: Enum.all?(sets, fn {set, _} -> set >= first end)

  defp none_before?(_receiver, _first), do: false

  defp take_set(receiver, set, frames) do
    %{count: count, counts: {before, messages}, parts: parts} = receiver.sets[set]
    frame = for(n <- 0..(count - 1), do: parts[n]) |> IO.iodata_to_binary()
    lost = max(before - receiver.messages, 0)
    sets = Map.reject(receiver.sets, fn {other, _} -> other <= set end)
    receiver = %{receiver | sets: sets, next: set + 1, messages: before + messages}
    take_complete_frames(receiver, [{lost, frame} | frames])
  end

  @doc "Encodes the datagram that shows the server the address of the receiver."
  @spec encode_hello(<<_::128>>, non_neg_integer()) :: binary()
  def encode_hello(key, seq), do: encrypt_datagram(key, 1, seq, "here")

  @spec hello?(<<_::128>>, binary()) :: boolean()
  def hello?(key, datagram), do: decrypt_datagram(key, 1, datagram) == {:ok, "here"}

  defp encrypt_datagram(key, direction, seq, plain) do
    nonce = <<direction::32, seq::64>>
    {bytes, tag} = :crypto.crypto_one_time_aead(:aes_128_gcm, key, nonce, plain, "", @tag, true)
    <<seq::64, bytes::binary, tag::binary>>
  end

  defp decrypt_datagram(key, direction, <<seq::64, rest::binary>>) when byte_size(rest) >= @tag do
    size = byte_size(rest) - @tag
    <<bytes::binary-pinned_size(size), tag::binary>> = rest
    nonce = <<direction::32, seq::64>>

    case :crypto.crypto_one_time_aead(:aes_128_gcm, key, nonce, bytes, "", tag, false) do
      :error -> :error
      plain -> {:ok, plain}
    end
  end

  defp decrypt_datagram(_key, _side, _short), do: :error
end
