defmodule Situ.Studio.History do
  @moduledoc """
  Keeps the recent messages of streams in memory, bounded by age and bytes, for pages that show a running pipeline.

  One process writes the table (`put/4`); any process can read it without calling the writer.

      iex> history = Situ.Studio.History.new(seconds: 60)
      iex> Situ.Studio.History.put(history, "level", %Situ.Message{data: 1.5, originating_time: 10}, 8)
      iex> {:ok, message} = Situ.Studio.Source.History.latest_at(history, "level", 11)
      iex> message.data
      1.5
  """

  @enforce_keys [:messages, :streams, :max_age, :max_bytes]
  defstruct [:messages, :streams, :max_age, :max_bytes, live: true]

  @type t :: %__MODULE__{
          messages: :ets.table(),
          streams: :ets.table(),
          max_age: Situ.Time.duration(),
          max_bytes: pos_integer(),
          live: boolean()
        }

  @doc """
  Creates an empty history. Options: `:seconds` to keep (120), `:megabytes` to keep per stream (64), and `:live`,
  whether more messages will follow.
  """
  @spec new(keyword()) :: t()
  def new(opts \\ []) do
    %__MODULE__{
      messages: :ets.new(__MODULE__, [:ordered_set, :public, read_concurrency: true]),
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
  @spec put(t(), String.t(), Situ.Message.t(), non_neg_integer()) :: :ok
  def put(%__MODULE__{} = history, name, %Situ.Message{} = message, bytes) do
    open_stream(history, name, :any)
    key = {name, message.originating_time}
    known? = known_message?(:ets.lookup(history.messages, key))
    :ets.insert(history.messages, {key, message, bytes})
    if not known?, do: count_message(history, name, message.originating_time, bytes)
    :ok
  end

  # A pipeline that resumes from a checkpoint repeats messages; they are counted once and do not lower the last time.
  defp known_message?([{_, %{data: %Situ.Studio.Gap{}}, _}]), do: false
  defp known_message?(rows), do: rows != []

  defp count_message(history, name, time, bytes) do
    [{_, type, count, held, first, last, total, kept}] = :ets.lookup(history.streams, name)
    {first, last} = {min(first || time, time), max(last || time, time)}
    row = {name, type, count + 1, held + bytes, first, last, total + bytes, kept + 1}
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
  not counted; its data is a `Situ.Studio.Gap`.
  """
  @spec mark_gap(t(), String.t(), Situ.Time.t() | nil) :: :ok
  def mark_gap(%__MODULE__{}, _name, nil), do: :ok

  def mark_gap(%__MODULE__{} = history, name, last) do
    hole = %Situ.Message{data: %Situ.Studio.Gap{}, originating_time: last + 1}
    :ets.insert_new(history.messages, {{name, last + 1}, hole, 0})
    :ok
  end

  defp drop_old(history, {name, type, count, held, first, last, total, kept} = row) do
    if held > history.max_bytes or last - first > history.max_age do
      case :ets.lookup(history.messages, {name, first}) do
        [{key, _, bytes}] ->
          next = :ets.next(history.messages, key)
          :ets.delete(history.messages, key)

          case next do
            {^name, time} ->
              drop_old(history, {name, type, count, held - bytes, time, last, total, kept - 1})

            _ ->
              {name, type, count, 0, last, last, total, 1}
          end

        [] ->
          {name, type, count, held, last, last, total, kept}
      end
    else
      row
    end
  end

  @doc "Estimates the size of a term in bytes cheaply: the byte size of binaries, the size in words of other terms."
  @spec estimate_size(term()) :: non_neg_integer()
  def estimate_size(%{data: data}) when is_binary(data), do: byte_size(data)
  def estimate_size(data) when is_binary(data), do: byte_size(data)
  def estimate_size(data) when is_number(data) or is_atom(data), do: 16
  def estimate_size(data), do: :erts_debug.flat_size(data) * 8
end
