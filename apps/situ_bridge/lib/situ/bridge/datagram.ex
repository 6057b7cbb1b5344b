defmodule Situ.Bridge.Datagram do
  @moduledoc false
  # Splits payloads of any size into datagrams (UDP) of a limited size, and joins them again.
  #
  # A chunk is `<<set::little-signed-64, count::little-16, number::little-16>>`, padded with zeros to 40 bytes and
  # followed by a part of the payload, as in \psi. Chunks may arrive in any order, twice, or not at all. An
  # incomplete set is abandoned and counted when a later set is complete, or when 16 later sets have begun. With
  # `new(open: 1)`, any chunk of another set abandons the open set, as in \psi's receiver.
  import Situ.BinarySize, only: [pinned_size: 1]

  @header 40
  @max_parts 0xFFFF

  defstruct sets: %{}, started: 0, abandoned: 0, received: 0, last_set: nil, open: 16

  @type t :: %__MODULE__{}

  @doc """
  Splits the payload into chunks of at most `max` bytes. Raises `ArgumentError` if the payload needs more than 65,535
  chunks.

      iex> alias Situ.Bridge.Datagram
      iex> [one, two] = Datagram.split_payload("hello", 7, 43)
      iex> {nil, state} = Datagram.push(Datagram.new(), two)
      iex> {payload, _} = Datagram.push(state, one)
      iex> payload
      "hello"
  """
  @spec split_payload(binary(), integer(), pos_integer()) :: [binary()]
  def split_payload(payload, set, max \\ 0xFFFE) when max > @header do
    parts = split_parts(payload, max - @header)
    count = length(parts)

    if count > @max_parts,
      do:
        raise(
          ArgumentError,
          "#{byte_size(payload)} bytes take #{count} datagrams; the maximum is #{@max_parts}"
        )

    for {part, number} <- Enum.with_index(parts),
        do: <<set::little-signed-64, count::little-16, number::little-16, 0::224, part::binary>>
  end

  defp split_parts(payload, size) when byte_size(payload) <= size, do: [payload]

  defp split_parts(payload, size) do
    <<part::binary-pinned_size(size), rest::binary>> = payload
    [part | split_parts(rest, size)]
  end

  @doc "Returns an empty state. `open:` is the maximum number of incomplete sets, 16 by default."
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: struct!(__MODULE__, Keyword.validate!(opts, [:open]))

  @doc "Adds a datagram; returns the payload that it completes, or `nil`. Datagrams that are not chunks are ignored."
  @spec push(t(), binary()) :: {binary() | nil, t()}
  def push(
        state,
        <<set::little-signed-64, count::little-16, number::little-16, _::224, part::binary>>
      )
      when number < count do
    state = %{state | received: state.received + 1}

    if late_set?(state, set),
      do: {nil, state},
      else: put_chunk(state, set, {count, number, :binary.copy(part)})
  end

  def push(state, _noise), do: {nil, state}

  defp late_set?(state, set),
    do: state.last_set != nil and set <= state.last_set and not is_map_key(state.sets, set)

  defp put_chunk(state, set, {count, number, part}) do
    state = if is_map_key(state.sets, set), do: state, else: begin_set(state, set, count)

    case state.sets do
      # A chunk that gives a different count for the same set is ignored.
      %{^set => {^count, parts}} -> complete_set(state, set, count, Map.put(parts, number, part))
      _ -> {nil, state}
    end
  end

  defp begin_set(state, set, count) do
    state = %{state | sets: Map.put(state.sets, set, {count, %{}}), started: state.started + 1}

    cond do
      map_size(state.sets) <= state.open -> state
      state.open == 1 -> abandon_sets(state, Map.keys(state.sets) -- [set])
      true -> abandon_sets(state, [Enum.min(Map.keys(state.sets))])
    end
  end

  defp complete_set(state, set, count, parts) when map_size(parts) == count do
    payload = for i <- 0..(count - 1), into: "", do: Map.fetch!(parts, i)
    last_set = max(state.last_set || set, set)
    state = %{state | sets: Map.delete(state.sets, set), last_set: last_set}
    {payload, abandon_sets(state, Enum.filter(Map.keys(state.sets), &(&1 < set)))}
  end

  defp complete_set(state, set, count, parts),
    do: {nil, %{state | sets: Map.put(state.sets, set, {count, parts})}}

  defp abandon_sets(state, sets),
    do: %{state | sets: Map.drop(state.sets, sets), abandoned: state.abandoned + length(sets)}
end
