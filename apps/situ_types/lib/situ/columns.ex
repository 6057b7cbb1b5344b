defmodule Situ.Columns do
  @moduledoc """
  Many messages of plain numbers as binary columns: one for the times and one for the values. Computing with them takes
  a few nanoseconds per message (`Nx.from_binary/2`, `:binary`), because there is no term for each message.

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

  alias Situ.{Error, Message}

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

  @least -0x8000000000000000
  @most 0x7FFFFFFFFFFFFFFF

  @doc """
  Builds columns of lists of times and values, of which there must be equally many. Raises `Situ.Error` if the values are
  not all integers of 64 bits, all floats or all booleans.
  """
  @spec new([Situ.Time.t(), ...], [value(), ...]) :: t()
  def new([_ | _] = times, [value | _] = values) when length(times) == length(values) do
    with {:ok, kind} <- value_kind(value), {:ok, values} <- pack_values(kind, values) do
      times = for time <- times, into: <<>>, do: <<time::little-signed-64>>
      %__MODULE__{kind: kind, count: div(byte_size(times), 8), times: times, values: values}
    else
      {:error, value} -> raise mixed_error(value)
    end
  end

  @doc false
  # Builds columns of the lists of a batch: times relative to `base`, and data of which the type is not known.
  @spec pack_lists(Situ.Time.t(), [integer(), ...], [term(), ...]) ::
          {:ok, t()} | {:error, term()}
  def pack_lists(base, times, [value | _] = values) do
    with {:ok, kind} <- value_kind(value), {:ok, values} <- pack_values(kind, values) do
      times = for dt <- times, into: <<>>, do: <<base + dt::little-signed-64>>
      count = div(byte_size(times), 8)
      {:ok, mark_checked(%__MODULE__{kind: kind, count: count, times: times, values: values})}
    end
  end

  @doc """
  Builds columns of messages with their envelopes, or returns the first value that does not fit to the others. The
  sequence ids must have no gaps.
  """
  @spec from_messages([Message.t(), ...]) :: {:ok, t()} | {:error, term()}
  def from_messages([%Message{data: value} = first | _] = messages) do
    with {:ok, kind} <- value_kind(value),
         {:ok, values} <- pack_values(kind, Enum.map(messages, & &1.data)) do
      pack =
        &for(message <- messages, into: <<>>, do: <<Map.fetch!(message, &1)::little-signed-64>>)

      {:ok,
       %__MODULE__{
         kind: kind,
         count: length(messages),
         times: pack.(:originating_time),
         values: values,
         creation_times: pack.(:creation_time),
         sequence_id: first.sequence_id,
         source_id: first.source_id
       }}
    end
  end

  @doc "Returns the messages, each with its envelope."
  @spec messages(t()) :: [Message.t()]
  def messages(%__MODULE__{} = columns) do
    creations = creation_list(columns)
    build_messages(times(columns), values(columns), creations, columns.sequence_id || 0, columns)
  end

  defp build_messages([], [], _creations, _id, _columns), do: []

  defp build_messages([time | times], [value | values], creations, id, columns) do
    {creation, creations} = pop_creation(creations)

    message = %Message{
      data: value,
      originating_time: time,
      creation_time: creation,
      sequence_id: id,
      source_id: columns.source_id
    }

    [message | build_messages(times, values, creations, id + 1, columns)]
  end

  defp creation_list(%{creation_times: times}) when is_binary(times), do: unpack_times(times)
  defp creation_list(%{creation_times: time}), do: time || 0

  defp pop_creation([time | times]), do: {time, times}
  defp pop_creation(time), do: {time, time}

  @doc "Returns the originating times as a list."
  @spec times(t()) :: [Situ.Time.t()]
  def times(%__MODULE__{times: times}), do: unpack_times(times)

  defp unpack_times(bytes), do: for(<<time::little-signed-64 <- bytes>>, do: time)

  @doc "Returns the values as a list."
  @spec values(t()) :: [value()]
  def values(%__MODULE__{kind: :integer, values: bytes}),
    do: for(<<n::little-signed-64 <- bytes>>, do: n)

  def values(%__MODULE__{kind: :float, values: bytes}),
    do: for(<<x::little-float-64 <- bytes>>, do: x)

  def values(%__MODULE__{kind: :boolean, values: bytes}), do: for(<<b <- bytes>>, do: b == 1)

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

    if byte_size(values) == columns.count * value_width(kind) and valid?(kind, values),
      do: replace_values(columns, kind, values),
      else: raise(bytes_error(columns, values, kind))
  end

  def put_values(%__MODULE__{count: count} = columns, [value | _] = values, _kind)
      when length(values) == count do
    with {:ok, kind} <- value_kind(value), {:ok, values} <- pack_values(kind, values) do
      replace_values(columns, kind, values)
    else
      {:error, value} -> raise mixed_error(value)
    end
  end

  def put_values(%__MODULE__{} = columns, values, _kind) when is_list(values),
    do: raise(count_error(columns, length(values)))

  defp replace_values(columns, kind, values) do
    %{drop_envelopes(columns) | kind: kind, values: values}
    |> put_checked(times_checked?(columns))
  end

  @doc "Drops creation times and sequence ids: the output that emits the messages sets new ones."
  @spec drop_envelopes(t()) :: t()
  def drop_envelopes(%__MODULE__{} = columns),
    do: %{columns | creation_times: nil, sequence_id: nil}

  @doc "Returns the messages `from` (0 is the first) to `from + count - 1`, without copying them."
  @spec slice(t(), non_neg_integer(), pos_integer()) :: t()
  def slice(%__MODULE__{count: count} = columns, 0, count), do: columns

  def slice(%__MODULE__{} = columns, from, count) when from + count <= columns.count do
    width = value_width(columns.kind)
    id = columns.sequence_id

    slice = %{
      columns
      | count: count,
        times: binary_part(columns.times, from * 8, count * 8),
        values: binary_part(columns.values, from * width, count * width),
        creation_times: slice_times(columns.creation_times, from, count),
        sequence_id: if(id, do: id + from)
    }

    put_checked(slice, checked?(columns))
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
    do: bisect(times, time, 0, count)

  defp bisect(_times, _time, from, from), do: from

  defp bisect(times, time, from, to) do
    middle = div(from + to, 2)

    if fetch_time(times, middle) <= time,
      do: bisect(times, time, middle + 1, to),
      else: bisect(times, time, from, middle)
  end

  @doc "Returns the first time that is not later than the one before it (the first: than `last`), or `nil`."
  @spec find_unordered(t(), Situ.Time.t() | nil) :: {Situ.Time.t(), Situ.Time.t()} | nil
  def find_unordered(%__MODULE__{times: times} = columns, last) do
    <<first::little-signed-64, rest::binary>> = times

    cond do
      last != nil and first <= last ->
        {first, last}

      checked?(columns) ->
        nil

      true ->
        <<low::little-32, high::little-signed-32, _::binary>> = times
        find_unordered(rest, high, low)
    end
  end

  @doc "Notes that the times and values have been checked."
  @spec mark_checked(t()) :: t()
  def mark_checked(%__MODULE__{} = columns), do: put_checked(columns, true)

  defp put_checked(columns, true), do: %{columns | checked: {columns.times, columns.values}}
  defp put_checked(columns, false), do: %{columns | checked: nil}

  defp checked?(%{checked: {times, values}, times: times, values: values}), do: true
  defp checked?(_columns), do: false

  defp times_checked?(%{checked: {times, _values}, times: times}), do: true
  defp times_checked?(_columns), do: false

  # Halves of 32 bits are small integers of the VM; nanoseconds since 1970 are not.
  defp find_unordered(<<low::little-32, high::little-signed-32, rest::binary>>, before, below) do
    if high > before or (high == before and low > below) do
      find_unordered(rest, high, low)
    else
      {high * 0x100000000 + low, before * 0x100000000 + below}
    end
  end

  defp find_unordered(<<>>, _high, _low), do: nil

  @doc "Returns whether the creation times never go backwards, also from `last`."
  @spec creation_ordered?(t(), Situ.Time.t() | nil) :: boolean()
  def creation_ordered?(%__MODULE__{creation_times: times}, last) when is_binary(times) do
    <<low::little-32, high::little-signed-32, rest::binary>> = times
    <<first::little-signed-64, _::binary>> = times
    (last == nil or first >= last) and ordered?(rest, high, low)
  end

  def creation_ordered?(%__MODULE__{creation_times: time}, last), do: last == nil or time >= last

  defp ordered?(<<low::little-32, high::little-signed-32, rest::binary>>, before, below)
       when high > before or (high == before and low >= below),
       do: ordered?(rest, high, low)

  defp ordered?(rest, _high, _low), do: rest == <<>>

  @doc "Checks that the fields fit to each other, for columns that were not built by these functions."
  @spec validate(t()) :: :ok | {:error, Error.t()}
  def validate(%__MODULE__{kind: kind, count: count, times: times, values: values} = columns)
      when kind in [:integer, :float, :boolean] and is_integer(count) and count > 0 and
             is_binary(times) and byte_size(times) == count * 8 and is_binary(values) do
    if byte_size(values) == count * value_width(kind) and valid_envelope?(columns) and
         (checked?(columns) or valid?(kind, values)),
       do: :ok,
       else: {:error, fields_error(columns)}
  end

  def validate(columns), do: {:error, fields_error(columns)}

  defp valid_envelope?(%{sequence_id: nil, creation_times: nil}), do: true

  defp valid_envelope?(%{sequence_id: id, creation_times: times, count: count})
       when is_integer(id) and id >= 0,
       do: is_integer(times) or (is_binary(times) and byte_size(times) == count * 8)

  defp valid_envelope?(_columns), do: false

  defp value_kind(value) when is_integer(value), do: {:ok, :integer}
  defp value_kind(value) when is_float(value), do: {:ok, :float}
  defp value_kind(value) when is_boolean(value), do: {:ok, :boolean}
  defp value_kind(value), do: {:error, value}

  defp pack_values(:integer, values), do: pack_integers(values, <<>>)
  defp pack_values(:float, values), do: pack_floats(values, <<>>)
  defp pack_values(:boolean, values), do: pack_booleans(values, <<>>)

  defp pack_integers([n | rest], bytes) when is_integer(n) and n >= @least and n <= @most,
    do: pack_integers(rest, <<bytes::binary, n::little-signed-64>>)

  defp pack_integers(rest, bytes), do: packed(rest, bytes)

  defp pack_floats([x | rest], bytes) when is_float(x),
    do: pack_floats(rest, <<bytes::binary, x::little-float-64>>)

  defp pack_floats(rest, bytes), do: packed(rest, bytes)

  defp pack_booleans([b | rest], bytes) when is_boolean(b),
    do: pack_booleans(rest, <<bytes::binary, if(b, do: 1, else: 0)>>)

  defp pack_booleans(rest, bytes), do: packed(rest, bytes)

  defp packed([], bytes), do: {:ok, bytes}
  defp packed([value | _rest], _bytes), do: {:error, value}

  defp value_width(:boolean), do: 1
  defp value_width(_kind), do: 8

  # A float that is not finite does not match `float`.
  defp valid?(:float, bytes), do: finite?(bytes)
  defp valid?(:boolean, bytes), do: for(<<b <- bytes>>, b > 1, do: b) == []
  defp valid?(:integer, _bytes), do: true

  defp finite?(<<_::binary-6, low, high, rest::binary>>) do
    # Exponent bits are all ones.
    if low >= 0xF0 and Bitwise.band(high, 0x7F) == 0x7F, do: false, else: finite?(rest)
  end

  defp finite?(<<>>), do: true

  defp mixed_error(value) do
    Error.new(
      :not_columns,
      "#{inspect(value, limit: 5, printable_limit: 80)} does not fit into a column",
      why: "a column holds integers of 64 bits, floats or booleans, and only one of these kinds",
      fix: "map the stream to numbers of one kind, or work with messages instead of columns"
    )
  end

  defp fields_error(columns) do
    Error.new(
      :not_columns,
      "the fields of #{inspect(columns, limit: 3)} do not fit to each other",
      why:
        "there are \"count\" times and values, floats are finite, and an envelope is complete or absent",
      fix: "build columns with Situ.Columns.new/2 and put_values/3"
    )
  end

  defp count_error(columns, count) do
    Error.new(:not_columns, "#{count} values cannot replace #{columns.count}",
      why: "each message keeps its time and gets one value",
      fix: "return as many values as there were"
    )
  end

  defp bytes_error(columns, bytes, kind) do
    if byte_size(bytes) == columns.count * value_width(kind) do
      Error.new(:not_columns, "these bytes are not values of the kind #{inspect(kind)}",
        why: "columns hold finite floats, and booleans as 0 or 1",
        fix: "replace NaN and infinities, or work with messages instead of columns"
      )
    else
      Error.new(:not_columns, "#{byte_size(bytes)} bytes cannot replace #{columns.count} values",
        why: "values of the kind #{inspect(kind)} take #{value_width(kind)} bytes each",
        fix: "return as many values as there were; name another kind in put_values/3"
      )
    end
  end
end
