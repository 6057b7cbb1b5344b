defmodule Situ.Remote.Link.Datagrams do
  @moduledoc """
  Frames as datagrams of any size, and back. Pure.

  A frame is cut into pieces, each a datagram: `seq` (64 bits, never used twice with a key), then, encrypted and
  authenticated by AES-128-GCM under a key that both sides agreed on over their connection:

  | bits | |
  |---|---|
  | 32 | set: the number of the frame |
  | 16, 16 | number of the piece (from 0), how many there are |
  | 64 | messages that were sent in the sets before |
  | 32 | messages in this set |
  | | the piece |

  The receiver puts sets together as their pieces come, in any order, some twice, some never. A set that lacks pieces is
  given up when two later ones are whole; sets come out in order, and how many messages were lost before each is known
  exactly, since every set says how many messages came before it.

      iex> alias Situ.Remote.Link.Datagrams
      iex> key = <<7::128>>
      iex> sender = Datagrams.sender(key, 80)
      iex> {[a, b], _} = Datagrams.split(sender, "a frame that is longer than its datagrams are", 3)
      iex> receiver = Datagrams.receiver(key)
      iex> {[], receiver} = Datagrams.take(receiver, b)
      iex> {[], receiver} = Datagrams.take(receiver, b)
      iex> {[{0, frame}], _} = Datagrams.take(receiver, a)
      iex> frame
      "a frame that is longer than its datagrams are"
  """
  import Situ.Bits, only: [known: 1]

  @head 20
  @tag 16
  @overhead 8 + @tag + @head
  @least @overhead + 1
  @most 65_507
  # How many sets may be incomplete at once, and how many later ones end the wait for one.
  @open 16
  @patience 2

  defmodule Sender do
    @moduledoc false
    defstruct [:key, :piece, seq: 0, set: 0, messages: 0]
  end

  defmodule Receiver do
    @moduledoc false
    defstruct [:key, next: 0, messages: 0, sets: %{}]
  end

  @type sender :: %Sender{}
  @type receiver :: %Receiver{}

  @doc "The smallest and the largest size of a datagram, bytes."
  @spec sizes() :: {pos_integer(), pos_integer()}
  def sizes, do: {@least, @most}

  @doc "Datagrams of `size` bytes at most."
  @spec sender(<<_::128>>, pos_integer()) :: sender()
  def sender(<<key::binary-16>>, size) when size in @least..@most,
    do: %Sender{key: key, piece: size - @overhead}

  @spec receiver(<<_::128>>) :: receiver()
  def receiver(<<key::binary-16>>), do: %Receiver{key: key}

  @doc "The datagrams of a frame with so many messages; none when it takes more than 65,535 of them: it is lost."
  @spec split(sender(), iodata(), non_neg_integer()) :: {[binary()], sender()}
  def split(%Sender{} = sender, frame, messages) do
    pieces = frame |> IO.iodata_to_binary() |> cut(sender.piece)
    count = length(pieces)
    later = %{sender | set: sender.set + 1, messages: sender.messages + messages}

    if count > 0xFFFF do
      {[], later}
    else
      {sent, seq} =
        Enum.map_reduce(Enum.with_index(pieces), sender.seq, fn {piece, number}, seq ->
          head = <<sender.set::32, number::16, count::16, sender.messages::64, messages::32>>
          {seal(sender.key, 0, seq, [head, piece]), seq + 1}
        end)

      {sent, %{later | seq: seq}}
    end
  end

  defp cut(bytes, size) when byte_size(bytes) <= size, do: [bytes]

  defp cut(bytes, size) do
    <<piece::binary-known(size), rest::binary>> = bytes
    [piece | cut(rest, size)]
  end

  @doc "The frames that are whole now, in order, each with the number of messages lost before it."
  @spec take(receiver(), binary()) :: {[{non_neg_integer(), binary()}], receiver()}
  def take(%Receiver{} = receiver, datagram) do
    with {:ok, <<set::32, number::16, count::16, before::64, messages::32, piece::binary>>} <-
           open(receiver.key, 0, datagram),
         true <- number < count and set >= receiver.next do
      receiver |> put(set, number, count, {before, messages}, piece) |> whole([])
    else
      # Somebody else's, or too late.
      _ -> {[], receiver}
    end
  end

  defp put(receiver, set, number, count, told, piece) do
    new = %{count: count, told: told, pieces: %{}}
    one = Map.get(receiver.sets, set, new)

    if one.count == count and one.told == told do
      one = %{one | pieces: Map.put(one.pieces, number, piece)}
      bounded(%{receiver | sets: Map.put(receiver.sets, set, one)})
    else
      receiver
    end
  end

  # A sender that begins many and ends none does not fill the memory.
  defp bounded(%{sets: sets} = receiver) when map_size(sets) > @open do
    oldest = sets |> Map.keys() |> Enum.min()
    %{receiver | sets: Map.delete(sets, oldest), next: max(receiver.next, oldest + 1)}
  end

  defp bounded(receiver), do: receiver

  defp whole(receiver, frames) do
    done = for {set, one} <- receiver.sets, map_size(one.pieces) == one.count, do: set

    case Enum.sort(done) do
      [] ->
        {Enum.reverse(frames), receiver}

      [first | later] ->
        if first == receiver.next or length(later) >= @patience or none_before?(receiver, first),
          do: receiver |> out(first, frames),
          else: {Enum.reverse(frames), receiver}
    end
  end

  # No earlier set has begun. Before the first set there is nothing to wait for.
  defp none_before?(%{next: 0, sets: sets}, first),
    do: Enum.all?(sets, fn {set, _} -> set >= first end)

  defp none_before?(_receiver, _first), do: false

  defp out(receiver, set, frames) do
    %{count: count, told: {before, messages}, pieces: pieces} = receiver.sets[set]
    frame = for(n <- 0..(count - 1), do: pieces[n]) |> IO.iodata_to_binary()
    lost = max(before - receiver.messages, 0)
    sets = Map.reject(receiver.sets, fn {other, _} -> other <= set end)
    receiver = %{receiver | sets: sets, next: set + 1, messages: before + messages}
    whole(receiver, [{lost, frame} | frames])
  end

  @doc "A datagram by which a receiver says where it is."
  @spec hello(<<_::128>>, non_neg_integer()) :: binary()
  def hello(key, seq), do: seal(key, 1, seq, "here")

  @spec hello?(<<_::128>>, binary()) :: boolean()
  def hello?(key, datagram), do: open(key, 1, datagram) == {:ok, "here"}

  defp seal(key, side, seq, plain) do
    nonce = <<side::32, seq::64>>
    {bytes, tag} = :crypto.crypto_one_time_aead(:aes_128_gcm, key, nonce, plain, "", @tag, true)
    <<seq::64, bytes::binary, tag::binary>>
  end

  defp open(key, side, <<seq::64, rest::binary>>) when byte_size(rest) >= @tag do
    size = byte_size(rest) - @tag
    <<bytes::binary-known(size), tag::binary>> = rest
    nonce = <<side::32, seq::64>>

    case :crypto.crypto_one_time_aead(:aes_128_gcm, key, nonce, bytes, "", tag, false) do
      :error -> :error
      plain -> {:ok, plain}
    end
  end

  defp open(_key, _side, _short), do: :error
end
