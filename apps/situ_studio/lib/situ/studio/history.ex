defmodule Situ.Studio.History do
  @moduledoc """
  Keeps the recent messages of streams in memory, bounded by age and bytes, for pages that show a running pipeline.

  One process writes the table (`put/4`); any process can read it without calling the writer.

      iex> history = Situ.Studio.History.new(seconds: 60)
      iex> Situ.Studio.History.put(history, "level", %Situ.Message{data: 1.5, originating_time: 10}, 8)
      iex> recording = Situ.Studio.Recordings.History.wrap(history)
      iex> {:ok, message} = Situ.Store.latest_at(recording, "level", 11)
      iex> message.data
      1.5
  """
  # The messages of a stream are in the order of their times, and numbered in this order. The second table finds the
  # time of a number.
  alias Situ.{Error, Message}
  alias Situ.Studio.Gap

  @enforce_keys [:messages, :ordinals, :streams, :max_age, :max_bytes]
  defstruct [:messages, :ordinals, :streams, :max_age, :max_bytes, live: true]

  # This time is earlier than any other.
  @before_all -0x8000000000000000

  # One select reads many messages faster than single lookups, but it passes over the whole table.
  @many 1_000
  @lookup_cost 10
  @most_selected 1_000_000

  @type t :: %__MODULE__{
          messages: :ets.table(),
          ordinals: :ets.table(),
          streams: :ets.table(),
          max_age: Situ.Time.duration(),
          max_bytes: pos_integer(),
          live: boolean()
        }

  @typedoc "The figures of a stream: `total` bytes were received, and `stored` messages remain."
  @type stream :: %{
          name: String.t(),
          type: Situ.Type.t(),
          count: non_neg_integer(),
          first: Situ.Time.t() | nil,
          last: Situ.Time.t() | nil,
          total: non_neg_integer(),
          stored: non_neg_integer()
        }

  @doc """
  Creates an empty history. Options: `:seconds` to keep (120), `:megabytes` to keep per stream (64), and `:live`,
  whether more messages will follow.
  """
  @spec new(keyword()) :: t()
  def new(opts \\ []) do
    %__MODULE__{
      messages: :ets.new(__MODULE__, [:ordered_set, :public, read_concurrency: true]),
      ordinals: :ets.new(__MODULE__, [:set, :public, read_concurrency: true]),
      streams: :ets.new(__MODULE__, [:set, :public, read_concurrency: true]),
      max_age: Situ.Time.s(opts[:seconds] || 120),
      max_bytes: (opts[:megabytes] || 64) * 1_000_000,
      live: Keyword.get(opts, :live, true)
    }
  end

  @doc "Adds a stream before its first message; `type` as in `Situ.Type`."
  @spec open_stream(t(), String.t(), Situ.Type.t()) :: :ok
  def open_stream(%__MODULE__{streams: streams}, name, type) do
    :ets.insert_new(streams, {name, type, 0, 0, nil, nil, 0, 0})
    :ok
  end

  @doc "Appends a message of size `bytes`, and drops messages that exceed the limits."
  @spec put(t(), String.t(), Message.t(), non_neg_integer()) :: :ok
  def put(%__MODULE__{} = history, name, %Message{originating_time: time} = message, bytes) do
    open_stream(history, name, :any)

    # A pipeline that resumes from a checkpoint repeats messages; they are counted once and do not lower the last time.
    case :ets.lookup(history.messages, {name, time}) do
      [{key, known, _, ordinal}] ->
        :ets.insert(history.messages, {key, message, bytes, ordinal})
        if match?(%Gap{}, known.data), do: count_message(history, name, time, bytes)

      [] ->
        insert_message(history, name, message, bytes)
        count_message(history, name, time, bytes)
    end

    :ok
  end

  defp insert_message(%{messages: messages} = history, name, message, bytes) do
    key = {name, message.originating_time}
    next = :ets.update_counter(history.ordinals, name, {2, 1}, {name, 0})
    ordinal = renumber_later(history, name, :ets.next(messages, key), next - 1)
    :ets.insert(history.ordinals, {{name, ordinal}, message.originating_time})
    :ets.insert(messages, {key, message, bytes, ordinal})
  end

  # Makes room for a message that is not the last one: a resumed pipeline may fill an earlier gap. Returns its number.
  defp renumber_later(%{messages: messages} = history, name, {name, time} = key, next) do
    found = :ets.match(messages, {key, :_, :_, :"$1"})
    following = renumber_later(history, name, :ets.next(messages, key), next)

    case found do
      [[ordinal]] ->
        :ets.insert(history.ordinals, {{name, ordinal + 1}, time})
        :ets.update_element(messages, key, {4, ordinal + 1})
        ordinal

      # The message has just expired.
      [] ->
        following
    end
  end

  defp renumber_later(_history, _name, _end_of_stream, next), do: next

  defp count_message(history, name, time, bytes) do
    [{_, type, count, size, first, last, total, stored}] = :ets.lookup(history.streams, name)
    {first, last} = {min(first || time, time), max(last || time, time)}
    row = {name, type, count + 1, size + bytes, first, last, total + bytes, stored + 1}
    :ets.insert(history.streams, drop_old(history, row))
  end

  @doc "Returns the time of the newest message of a stream, or `nil` before the first."
  @spec last_time(t(), String.t()) :: Situ.Time.t() | nil
  def last_time(%__MODULE__{streams: streams}, name) do
    case :ets.lookup(streams, name) do
      [{_, _, _, _, _, last, _, _}] -> last
      [] -> nil
    end
  end

  @doc """
  Marks the start of a gap after the message at `last`: the stream was not captured until its next message. The gap is
  not counted, and visualizers draw nothing in it.
  """
  @spec mark_gap(t(), String.t(), Situ.Time.t() | nil) :: :ok
  def mark_gap(%__MODULE__{}, _name, nil), do: :ok

  def mark_gap(%__MODULE__{} = history, name, last) do
    gap = %Message{data: %Gap{}, originating_time: last + 1}

    if not :ets.member(history.messages, {name, last + 1}),
      do: insert_message(history, name, gap, 0)

    :ok
  end

  defp drop_old(history, {name, type, count, size, first, last, total, stored} = row) do
    if size > history.max_bytes or last - first > history.max_age do
      case :ets.lookup(history.messages, {name, first}) do
        [{key, _, bytes, ordinal}] ->
          next = :ets.next(history.messages, key)
          :ets.delete(history.messages, key)
          :ets.delete(history.ordinals, {name, ordinal})

          case next do
            {^name, time} ->
              drop_old(history, {name, type, count, size - bytes, time, last, total, stored - 1})

            _ ->
              {name, type, count, 0, last, last, total, 1}
          end

        [] ->
          {name, type, count, size, last, last, total, stored}
      end
    else
      row
    end
  end

  @doc "Lists the streams. Raises the error `:gone` if the process that owns the history has ended."
  @spec list_streams(t()) :: [stream()]
  def list_streams(%__MODULE__{streams: streams}) do
    streams |> :ets.tab2list() |> Enum.map(&stream_figures/1)
  rescue
    ArgumentError -> raise gone_error()
  end

  @doc "Returns a stream, or `:none` if it is unknown. Raises the error `:gone`."
  @spec fetch_stream(t(), String.t()) :: {:ok, stream()} | :none
  def fetch_stream(%__MODULE__{streams: streams}, name) do
    case :ets.lookup(streams, name) do
      [row] -> {:ok, stream_figures(row)}
      [] -> :none
    end
  rescue
    ArgumentError -> raise gone_error()
  end

  defp stream_figures({name, type, count, _size, first, last, total, stored}) do
    figures = %{count: count, first: first, last: last, total: total, stored: stored}
    Map.merge(figures, %{name: name, type: type})
  end

  @doc "Returns the number of the first message at or after `time`, or the next number. Raises the error `:gone`."
  @spec find_ordinal(t(), String.t(), Situ.Time.t()) :: non_neg_integer()
  def find_ordinal(%__MODULE__{messages: messages} = history, name, time) do
    with {^name, _} = key <- :ets.next(messages, {name, time - 1}),
         [{_, _, _, ordinal}] <- :ets.lookup(messages, key) do
      ordinal
    else
      # The message has just expired.
      [] -> find_ordinal(history, name, time)
      _end_of_stream -> next_ordinal(history, name)
    end
  rescue
    ArgumentError -> raise gone_error()
  end

  defp next_ordinal(%{ordinals: ordinals}, name) do
    case :ets.lookup(ordinals, name) do
      [{_, next}] -> next
      [] -> 0
    end
  end

  @doc """
  Reads about `limit` messages at or before `to` from a number on, and returns them with the next number. If the reader
  wants `total` messages in all, up to that many are returned together if that is faster. Raises the error `:gone`.
  """
  @spec read_messages(
          t(),
          String.t(),
          non_neg_integer(),
          Situ.Time.t() | :unbounded,
          {limit :: pos_integer(), total :: pos_integer() | nil}
        ) :: {[Message.t()], non_neg_integer()}
  def read_messages(%__MODULE__{messages: messages} = history, name, ordinal, to, {limit, total}) do
    key = first_key(history, name, ordinal)
    total = min(total || @most_selected, @most_selected)

    if limit >= @many and cheaper_to_select?(history, key, {name, ordinal, to}, total) do
      select_rows(messages, key, to, total)
    else
      collect_rows(messages, key, {name, to}, limit)
    end
    |> Enum.map_reduce(ordinal, fn {_, message, _, ordinal}, _ -> {message, ordinal + 1} end)
  rescue
    ArgumentError -> raise gone_error()
  end

  defp first_key(%{messages: messages} = history, name, ordinal) do
    case :ets.lookup(history.ordinals, {name, ordinal}) do
      [{_, time}] ->
        {name, time}

      # The message has expired, or does not exist yet.
      [] ->
        if ordinal < next_ordinal(history, name), do: :ets.next(messages, {name, @before_all})
    end
  end

  defp cheaper_to_select?(history, {_, _}, {name, ordinal, to}, total) do
    stop =
      if to == :unbounded,
        do: next_ordinal(history, name),
        else: find_ordinal(history, name, to + 1)

    min(stop - ordinal, total) * @lookup_cost > :ets.info(history.messages, :size)
  end

  defp cheaper_to_select?(_history, _key, _window, _total), do: false

  # The atom `:unbounded` sorts after all numbers.
  defp select_rows(messages, {name, from}, to, total) do
    guards = [{:>=, :"$1", from}, {:"=<", :"$1", to}]

    case :ets.select(messages, [{{{name, :"$1"}, :_, :_, :_}, guards, [:"$_"]}], total) do
      {rows, _continuation} -> rows
      :"$end_of_table" -> []
    end
  end

  defp collect_rows(messages, {name, time} = key, {name, to} = stop, limit)
       when limit > 0 and time <= to do
    next = :ets.next(messages, key)
    :ets.lookup(messages, key) ++ collect_rows(messages, next, stop, limit - 1)
  end

  defp collect_rows(_messages, _end_of_stream, _stop, _limit), do: []

  defp gone_error, do: Error.new(:gone, "the pipeline no longer exists")

  @doc "Estimates the size of a term in bytes cheaply: the byte size of binaries, the size in words of other terms."
  @spec estimate_size(term()) :: non_neg_integer()
  def estimate_size(%{data: data}) when is_binary(data), do: byte_size(data)
  def estimate_size(data) when is_binary(data), do: byte_size(data)
  def estimate_size(data) when is_number(data) or is_atom(data), do: 16
  def estimate_size(data), do: :erts_debug.flat_size(data) * 8
end
