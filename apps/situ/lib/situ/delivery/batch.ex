defmodule Situ.Delivery.Batch do
  @moduledoc false
  # Messages of one output that travel together. Messages that were created at the same time share one envelope:
  # their times and data are two lists, which cost four words per message instead of fourteen. Messages with
  # different envelopes (from a store or another process) are a list of `Situ.Message`, and numbers may be
  # `Situ.Columns` with their envelopes (docs/adr/0167-numbers-may-travel-as-columns.md).
  #
  # Times are relative to `base`, because nanoseconds since 1970 do not fit into a small integer of the VM.
  alias Situ.{Columns, Message}

  @enforce_keys [:source_id, :created, :first_id, :last_time, :base, :times, :data, :size]
  defstruct [:source_id, :created, :first_id, :last_time, :base, :times, :data, :size]

  @type shared :: %__MODULE__{
          source_id: non_neg_integer(),
          created: Situ.Time.t(),
          first_id: non_neg_integer(),
          last_time: Situ.Time.t(),
          base: Situ.Time.t(),
          times: [integer(), ...],
          data: [term(), ...],
          size: pos_integer()
        }
  @type t :: shared() | [Message.t(), ...] | Columns.t()

  @spec size(t()) :: pos_integer()
  def size(%__MODULE__{size: size}), do: size
  def size(%Columns{count: count}), do: count
  def size(messages), do: length(messages)

  @doc "Returns the originating time of the first message."
  @spec first_time(t()) :: Situ.Time.t()
  def first_time(%__MODULE__{base: base, times: [dt | _]}), do: base + dt
  def first_time(%Columns{} = columns), do: Columns.first_time(columns)
  def first_time([%Message{originating_time: time} | _]), do: time

  @doc "Returns the originating time of the last message."
  @spec last_time(t()) :: Situ.Time.t()
  def last_time(%__MODULE__{last_time: time}), do: time
  def last_time(%Columns{} = columns), do: Columns.last_time(columns)
  def last_time(messages), do: :lists.last(messages).originating_time

  @doc "Returns the originating time, the creation time and the sequence id of the last message."
  @spec last_stamp(t()) :: {Situ.Time.t(), Situ.Time.t(), non_neg_integer()}
  def last_stamp(%__MODULE__{} = batch),
    do: {last_time(batch), batch.created, batch.first_id + batch.size - 1}

  def last_stamp(%Columns{} = columns), do: Columns.last_stamp(columns)

  def last_stamp(messages) do
    last = :lists.last(messages)
    {last.originating_time, last.creation_time, last.sequence_id}
  end

  @doc "Returns the time that `times/1` are relative to."
  @spec base(t()) :: Situ.Time.t()
  def base(%__MODULE__{base: base}), do: base
  def base(%Columns{} = columns), do: Columns.first_time(columns)
  def base([%Message{originating_time: time} | _]), do: time

  @doc "Returns the originating times, relative to `base/1`."
  @spec times(t()) :: [integer(), ...]
  def times(%__MODULE__{times: times}), do: times

  def times(%Columns{} = columns) do
    base = Columns.first_time(columns)
    for time <- Columns.times(columns), do: time - base
  end

  def times([%Message{originating_time: base} | _] = messages),
    do: for(%{originating_time: time} <- messages, do: time - base)

  @spec first_data(shared() | [Message.t(), ...]) :: term()
  def first_data(%__MODULE__{data: [data | _]}), do: data
  def first_data([%Message{data: data} | _]), do: data

  @spec data(t()) :: [term(), ...]
  def data(%__MODULE__{data: data}), do: data
  def data(%Columns{} = columns), do: Columns.values(columns)
  def data(messages), do: for(%{data: data} <- messages, do: data)

  @doc "Returns the size of one message's data in bytes, as `Situ.Message.data_size/1` does."
  @spec data_size(term()) :: non_neg_integer()
  def data_size(data), do: Message.data_size(%Message{data: data, originating_time: 0})

  @doc "Returns the messages, each with its envelope."
  @spec messages(t()) :: [Message.t(), ...]
  def messages(%__MODULE__{} = batch),
    do: messages(batch.times, batch.data, batch.first_id, batch, Message)

  def messages(%Columns{} = columns), do: Columns.messages(columns)
  def messages(messages), do: messages

  defp messages([], [], _id, _batch, _struct), do: []

  defp messages([dt | times], [data | rest], id, batch, struct),
    do: [message(dt, data, id, batch, struct) | messages(times, rest, id + 1, batch, struct)]

  # The name of the struct is an argument: with `%Message{}`, the compiler extends a map of one key, which takes longer
  # and gives every message a copy of the keys.
  defp message(dt, data, id, %{base: base, created: created, source_id: source_id}, struct),
    do: %{
      __struct__: struct,
      data: data,
      originating_time: base + dt,
      creation_time: created,
      sequence_id: id,
      source_id: source_id
    }

  @doc "Returns numbers of one kind as columns, or `:error`."
  @spec columns(t()) :: {:ok, Columns.t()} | :error
  def columns(%Columns{} = columns), do: {:ok, columns}

  def columns(%__MODULE__{created: created, first_id: id, source_id: source} = batch) do
    case Columns.pack_lists(batch.base, batch.times, batch.data) do
      {:ok, columns} ->
        {:ok, %{columns | creation_times: created, sequence_id: id, source_id: source}}

      {:error, _value} ->
        :error
    end
  end

  def columns(messages), do: Columns.from_messages(messages)

  @doc "Takes the first message; the rest is `nil` after the last one."
  @spec pop(t()) :: {Message.t(), t() | nil}
  def pop(%__MODULE__{times: [dt | times], data: [data | rest], first_id: id} = batch) do
    message = message(dt, data, id, batch, Message)

    if times == [],
      do: {message, nil},
      else: {message, %{batch | times: times, data: rest, first_id: id + 1, size: batch.size - 1}}
  end

  def pop(%Columns{} = columns) do
    {first, rest} = split(columns, 1)
    [message] = Columns.messages(first)
    {message, rest}
  end

  def pop([message]), do: {message, nil}
  def pop([message | rest]), do: {message, rest}

  @doc "Splits off the first `n` messages; the rest is `nil` if there are no more than these."
  @spec split(t(), pos_integer() | :infinity) :: {t(), t() | nil}
  def split(batch, :infinity), do: {batch, nil}
  def split(%__MODULE__{size: size} = batch, n) when size <= n, do: {batch, nil}

  def split(%__MODULE__{size: size, first_id: id} = batch, n) do
    {times, later_times} = :lists.split(n, batch.times)
    {data, later} = :lists.split(n, batch.data)

    {%{batch | times: times, data: data, size: n, last_time: batch.base + :lists.last(times)},
     %{batch | times: later_times, data: later, first_id: id + n, size: size - n}}
  end

  def split(%Columns{count: count} = columns, n) when count <= n, do: {columns, nil}

  def split(%Columns{count: count} = columns, n),
    do: {Columns.slice(columns, 0, n), Columns.slice(columns, n, count - n)}

  def split(messages, n) do
    case Enum.split(messages, n) do
      {taken, []} -> {taken, nil}
      split -> split
    end
  end

  @doc "Splits off the messages up to the originating time `time`; either part may be `nil`."
  @spec split_after(t(), Situ.Time.t()) :: {t() | nil, t() | nil}
  def split_after(batch, time) do
    cond do
      first_time(batch) > time -> {nil, batch}
      last_time(batch) <= time -> {batch, nil}
      true -> split(batch, count_until(batch, time))
    end
  end

  defp count_until(%__MODULE__{base: base, times: times}, time),
    do: Enum.count(times, &(base + &1 <= time))

  defp count_until(%Columns{} = columns, time), do: Columns.count_until(columns, time)

  defp count_until(messages, time), do: Enum.count(messages, &(&1.originating_time <= time))
end
