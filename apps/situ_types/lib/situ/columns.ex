defmodule Situ.Columns do
  @moduledoc """
  Many messages of plain numbers as binary columns: one for the times and one for the values. Computing with them takes
  a few nanoseconds per message (`Nx.from_binary/2`, `:binary`), because no message is built.

  Streams of a pipeline carry columns where both sides understand them: `Situ.map/3` and `Situ.each/3` with
  `columns: true`, windows with `with: :columns`, recordings, and components with `c:Situ.Component.handle_columns/4`.
  All other components receive the same messages one by one.

      iex> columns = Situ.Columns.new([10, 20, 30], [0.5, 1.0, 1.5])
      iex> {columns.kind, columns.count}
      {:float, 3}
      iex> doubled = Situ.Columns.put_values(columns, for(<<x::little-float-64 <- columns.values>>, do: x * 2))
      iex> Situ.Columns.to_pairs(doubled)
      [{10, 1.0}, {20, 2.0}, {30, 3.0}]

  | field | content |
  |---|---|
  | `kind` | `:integer` (64 bits, signed), `:float` (64 bits, finite) or `:boolean` |
  | `count` | the number of messages |
  | `times` | originating times, ns since 1970, eight bytes each (little-endian, signed), strictly increasing |
  | `values` | eight bytes each, little-endian; booleans take one byte each, 0 or 1 |
  | `creation_times` | one time for all messages, or a binary like `times` |
  | `sequence_id` | the sequence id of the first message; the others follow without a gap |
  | `source_id` | the output that emitted the messages |

  A component that emits columns leaves `creation_times` and `sequence_id` at `nil`: the pipeline sets them, as for any
  other message. `checked` is for the pipeline, so that it checks the same times and values only once.
  """

  alias Situ.Columns.{Validation, Values}
  alias Situ.{Error, Message}

  @compile {:inline, build_message: 2}

  @enforce_keys [:kind, :count, :times, :values]
  defstruct [
    :kind,
    :count,
    :times,
    :values,
    :creation_times,
    :sequence_id,
    :checked,
    source_id: 0
  ]

  @type kind :: :integer | :float | :boolean
  @type t :: %__MODULE__{
          kind: kind(),
          count: pos_integer(),
          times: binary(),
          values: binary(),
          creation_times: binary() | Situ.Time.t() | nil,
          sequence_id: non_neg_integer() | nil,
          source_id: non_neg_integer(),
          checked: {times :: binary(), values :: binary()} | nil
        }
  @type value :: integer() | float() | boolean()

  @doc """
  Builds columns of equally many times and values. Raises `Situ.Error` if the values are not all integers of 64 bits,
  all floats or all booleans, or a time does not fit into 64 bits.
  """
  @spec new([Situ.Time.t(), ...], [value(), ...]) :: t()
  def new([_ | _] = times, [_ | _] = values) when length(times) == length(values) do
    with {:ok, _bytes} <- Values.pack_values(:integer, times),
         {:ok, columns} <- build_columns(0, times, values) do
      columns
    else
      {:error, value} -> raise mixed_error(value)
    end
  end

  @doc false
  # Builds columns of the lists of a batch, whose times have been checked: they are relative to `base`.
  @spec pack_lists(Situ.Time.t(), [integer(), ...], [term(), ...]) ::
          {:ok, t()} | {:error, term()}
  def pack_lists(base, times, values) do
    with {:ok, columns} <- build_columns(base, times, values),
         do: {:ok, Validation.mark_checked(columns)}
  end

  defp build_columns(base, times, [value | _] = values) do
    with {:ok, kind} <- Values.value_kind(value),
         {:ok, values} <- Values.pack_values(kind, values) do
      times = for dt <- times, into: <<>>, do: <<base + dt::little-signed-64>>
      count = div(byte_size(times), 8)
      {:ok, %__MODULE__{kind: kind, count: count, times: times, values: values}}
    end
  end

  @doc """
  Builds columns of messages with their envelopes. Returns `:error` if the values are not numbers of one kind, or a
  sequence id is missing.
  """
  @spec from_messages([Message.t(), ...]) :: {:ok, t()} | :error
  def from_messages([%Message{} = first | _] = messages) do
    times = Enum.map(messages, & &1.originating_time)

    with true <- consecutive_ids?(messages, first.sequence_id),
         {:ok, columns} <- build_columns(0, times, Enum.map(messages, & &1.data)) do
      creations = for m <- messages, into: <<>>, do: <<m.creation_time::little-signed-64>>
      %{sequence_id: id, source_id: source} = first
      {:ok, %{columns | creation_times: creations, sequence_id: id, source_id: source}}
    else
      _gap_or_value -> :error
    end
  end

  defp consecutive_ids?([%{sequence_id: id} | rest], id), do: consecutive_ids?(rest, id + 1)
  defp consecutive_ids?(rest, _id), do: rest == []

  @doc "Returns the messages, each with its envelope."
  @spec messages(t()) :: [Message.t()]
  def messages(%__MODULE__{} = columns) do
    creations = creation_list(columns)
    envelope = {columns.sequence_id || 0, columns.source_id, Message}
    build_messages(times(columns), values(columns), creations, envelope)
  end

  defp build_messages([], [], _creations, _envelope), do: []

  defp build_messages([time | times], [value | values], [creation | creations], envelope) do
    {id, source_id, struct} = envelope
    message = build_message({time, value, creation}, envelope)
    [message | build_messages(times, values, creations, {id + 1, source_id, struct})]
  end

  defp build_messages([time | times], [value | values], creation, envelope) do
    {id, source_id, struct} = envelope
    message = build_message({time, value, creation}, envelope)
    [message | build_messages(times, values, creation, {id + 1, source_id, struct})]
  end

  # The name of the struct is an argument, as in Situ.Delivery.Batch, so that all messages share their keys.
  defp build_message({time, value, creation}, {id, source_id, struct}) do
    %{
      __struct__: struct,
      data: value,
      originating_time: time,
      creation_time: creation,
      sequence_id: id,
      source_id: source_id
    }
  end

  defp creation_list(%{creation_times: times}) when is_binary(times), do: unpack_times(times)
  defp creation_list(%{creation_times: time}), do: time || 0

  @doc "Returns the originating times as a list."
  @spec times(t()) :: [Situ.Time.t()]
  def times(%__MODULE__{times: times}), do: unpack_times(times)

  defp unpack_times(bytes), do: for(<<time::little-signed-64 <- bytes>>, do: time)

  @doc "Returns the values as a list."
  @spec values(t()) :: [value()]
  def values(%__MODULE__{kind: kind, values: bytes}), do: Values.unpack_values(kind, bytes)

  @doc "Returns the messages as pairs of originating time and value."
  @spec to_pairs(t()) :: [{Situ.Time.t(), value()}]
  def to_pairs(%__MODULE__{} = columns), do: Enum.zip(times(columns), values(columns))

  @doc "Returns the originating time of the first message."
  @spec first_time(t()) :: Situ.Time.t()
  def first_time(%__MODULE__{times: <<time::little-signed-64, _::binary>>}), do: time

  @doc "Returns the originating time of the last message."
  @spec last_time(t()) :: Situ.Time.t()
  def last_time(%__MODULE__{count: count} = columns), do: time_at(columns, count - 1)

  @doc "Returns the originating time of the message at an index (0 is the first)."
  @spec time_at(t(), non_neg_integer()) :: Situ.Time.t()
  def time_at(%__MODULE__{times: times}, index), do: fetch_time(times, index)

  @doc "Returns the originating time, the creation time and the sequence id of the last message. It needs an envelope."
  @spec last_stamp(t()) :: {Situ.Time.t(), Situ.Time.t(), non_neg_integer()}
  def last_stamp(%__MODULE__{sequence_id: id, count: count} = columns),
    do: {last_time(columns), last_creation_time(columns), id + count - 1}

  @doc "Returns the creation time of the last message, or `nil`."
  @spec last_creation_time(t()) :: Situ.Time.t() | nil
  def last_creation_time(%__MODULE__{creation_times: times, count: count}) when is_binary(times),
    do: fetch_time(times, count - 1)

  def last_creation_time(%__MODULE__{creation_times: time}), do: time

  defp fetch_time(times, index) do
    <<time::little-signed-64>> = binary_part(times, index * 8, 8)
    time
  end

  @doc """
  Replaces the values: by a list, or by a binary of as many values of the same kind. Give another kind as the third
  argument. The new messages have the same times, and no envelopes yet. Raises `Situ.Error` if the number or kind of
  values differs, or a float is not finite.
  """
  @spec put_values(t(), binary() | [value()], kind() | nil) :: t()
  def put_values(columns, values, kind \\ nil)

  def put_values(%__MODULE__{} = columns, values, kind)
      when is_binary(values) and kind in [nil, :integer, :float, :boolean] do
    kind = kind || columns.kind

    if byte_size(values) == columns.count * Values.value_width(kind) and
         Values.valid_values?(kind, values),
       do: replace_values(columns, kind, values),
       else: raise(bytes_error(columns, values, kind))
  end

  def put_values(%__MODULE__{count: count} = columns, [value | _] = values, _kind)
      when length(values) == count do
    with {:ok, kind} <- Values.value_kind(value),
         {:ok, values} <- Values.pack_values(kind, values) do
      replace_values(columns, kind, values)
    else
      {:error, value} -> raise mixed_error(value)
    end
  end

  def put_values(%__MODULE__{} = columns, values, _kind) when is_list(values),
    do: raise(count_error(columns, length(values)))

  defp replace_values(columns, kind, values) do
    %{drop_envelopes(columns) | kind: kind, values: values}
    |> Validation.mark_checked(Validation.times_checked?(columns))
  end

  @doc "Drops creation times and sequence ids: the output that emits the messages sets new ones."
  @spec drop_envelopes(t()) :: t()
  def drop_envelopes(%__MODULE__{} = columns),
    do: %{columns | creation_times: nil, sequence_id: nil}

  @doc "Returns the messages `from` (0 is the first) to `from + count - 1`, without copying them."
  @spec slice(t(), non_neg_integer(), pos_integer()) :: t()
  def slice(%__MODULE__{count: count} = columns, 0, count), do: columns

  def slice(%__MODULE__{} = columns, from, count) when from + count <= columns.count do
    width = Values.value_width(columns.kind)
    id = columns.sequence_id

    slice = %{
      columns
      | count: count,
        times: binary_part(columns.times, from * 8, count * 8),
        values: binary_part(columns.values, from * width, count * width),
        creation_times: slice_times(columns.creation_times, from, count),
        sequence_id: if(id, do: id + from)
    }

    Validation.mark_checked(slice, Validation.checked?(columns))
  end

  defp slice_times(times, from, count) when is_binary(times),
    do: binary_part(times, from * 8, count * 8)

  defp slice_times(time, _from, _count), do: time

  @doc """
  Appends columns of the same kind. Their envelopes are kept only if the sequence ids follow each other. Raises
  `Situ.Error` if the kinds differ.
  """
  @spec append(t(), t()) :: t()
  def append(%__MODULE__{kind: kind} = first, %__MODULE__{kind: kind} = second) do
    follows? = first.sequence_id != nil and second.sequence_id == first.sequence_id + first.count

    %{
      first
      | count: first.count + second.count,
        times: first.times <> second.times,
        values: first.values <> second.values,
        creation_times: if(follows?, do: creation_bytes(first) <> creation_bytes(second)),
        sequence_id: if(follows?, do: first.sequence_id),
        checked: nil
    }
  end

  def append(%__MODULE__{}, %__MODULE__{} = second), do: raise(mixed_error(hd(values(second))))

  defp creation_bytes(%{creation_times: times}) when is_binary(times), do: times

  defp creation_bytes(%{creation_times: time, count: count}),
    do: :binary.copy(<<time::little-signed-64>>, count)

  @doc "Splits the columns into columns of at most `most` messages each, in order."
  @spec split(t(), pos_integer()) :: [t()]
  def split(%__MODULE__{count: count} = columns, most) when count <= most, do: [columns]

  def split(%__MODULE__{count: count} = columns, most) do
    for at <- 0..(count - 1)//most, do: slice(columns, at, min(most, count - at))
  end

  @doc "Returns how many messages have an originating time up to `time`."
  @spec count_until(t(), Situ.Time.t()) :: non_neg_integer()
  def count_until(%__MODULE__{times: times, count: count}, time),
    do: bisect_times(times, time, 0, count)

  defp bisect_times(_times, _time, from, from), do: from

  defp bisect_times(times, time, from, to) do
    middle = div(from + to, 2)

    if fetch_time(times, middle) <= time,
      do: bisect_times(times, time, middle + 1, to),
      else: bisect_times(times, time, from, middle)
  end

  defp mixed_error(value) do
    Error.new(
      :not_columns,
      "#{inspect(value, limit: 5, printable_limit: 80)} does not fit into a column",
      why: "a column holds integers of 64 bits, floats or booleans, and only values of one kind",
      fix: "map the stream to numbers of one kind, or work with messages instead of columns"
    )
  end

  defp count_error(columns, count) do
    Error.new(:not_columns, "#{count} values cannot replace #{columns.count}",
      why: "each message keeps its time and gets one value",
      fix: "return as many values as there were"
    )
  end

  defp bytes_error(columns, bytes, kind) do
    if byte_size(bytes) == columns.count * Values.value_width(kind) do
      Error.new(:not_columns, "these bytes are not values of the kind #{inspect(kind)}",
        why: "columns hold finite floats, and booleans as 0 or 1",
        fix: "replace NaN and infinities, or work with messages instead of columns"
      )
    else
      Error.new(:not_columns, "#{byte_size(bytes)} bytes cannot replace #{columns.count} values",
        why: "values of the kind #{inspect(kind)} take #{Values.value_width(kind)} bytes each",
        fix: "return as many values as there were; name another kind in put_values/3"
      )
    end
  end

  defimpl Inspect do
    def inspect(columns, _opts),
      do: "#Situ.Columns<#{columns.count} messages, #{Kernel.inspect(columns.kind)}>"
  end
end
