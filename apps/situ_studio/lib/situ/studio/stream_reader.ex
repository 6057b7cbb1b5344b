defmodule Situ.Studio.StreamReader do
  @moduledoc false
  # Reads the messages that pages draw from any recording (`Situ.Recording`): a store, a session,
  # a comparison, or a running pipeline. A stream is named, or given as its
  # `Situ.Store.StreamInfo`.
  #
  # Times are inclusive at both ends. If the recording has gone, the functions return `{:error,
  # error}`, and the page shows the error.
  alias Situ.{Error, Message, Recording, Store}

  @type extent :: %{
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          live: boolean(),
          version: non_neg_integer()
        }

  @marks 2_000

  @doc """
  Returns the first and last time, whether the recording is live, and a version that changes when streams are added.
  """
  @spec fetch_extent(Recording.t()) :: {:ok, extent()} | {:error, Error.t()}
  def fetch_extent(recording) do
    streams = Store.streams(recording)
    info = Store.info(recording)
    now = Map.get(info, :now, 0)
    {from, to} = Store.interval(streams) || {now, now}
    {:ok, %{from: from, to: to, live: info.live?, version: length(streams)}}
  rescue
    error in Error -> {:error, error}
  end

  @doc "Returns descriptions of the damage of the recording; `[]` if it is fully readable."
  @spec list_damage(Recording.t()) :: [String.t()]
  def list_damage(recording) do
    Enum.map(Store.info(recording).damage, &Recording.describe_damage/1)
  rescue
    error in Error -> [Exception.message(error)]
  end

  @doc """
  Announces the streams that a page shows, even if it does not request data at the moment. A recording that captures
  streams on demand keeps capturing them.
  """
  @spec request_streams(Recording.t(), [String.t()]) :: :ok
  def request_streams(recording, names) do
    if names != [] and Recording.implements?(recording, :request_streams, 2),
      do: recording.module.request_streams(recording.state, names)

    :ok
  end

  @doc "Returns at most `limit` messages between two times, in order, and `:more` if there are more."
  @spec read_messages(Recording.t(), Store.name(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, [Message.t()], :all | :more} | {:error, Error.t()}
  def read_messages(recording, name, from, to, limit) do
    with {:ok, messages} <- Store.read(recording, name, from: from, to: to, limit: limit + 1) do
      if length(messages) > limit,
        do: {:ok, Enum.take(messages, limit), :more},
        else: {:ok, messages, :all}
    end
  end

  @doc "Returns times and latencies of at most `limit` messages; if there are more, evenly thinned and with `:more`."
  @spec read_marks(Recording.t(), Store.name(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, [{Situ.Time.t(), Situ.Time.duration()}], :all | :more} | {:error, Error.t()}
  def read_marks(recording, name, from, to, limit) do
    with {:ok, info} <- Store.stream_info(recording, name),
         {:ok, n} <- Store.count(recording, info, from, to),
         {:ok, messages} <- read_envelopes(recording, info, {from, to}, n, limit) do
      marks = for m <- messages, do: {m.originating_time, Message.latency(m)}
      {:ok, marks, if(n <= limit, do: :all, else: :more)}
    end
  end

  defp read_envelopes(recording, info, {from, to}, n, limit) when n <= limit,
    do: Store.read(recording, info, from: from, to: to, limit: n + 16, envelopes: true)

  defp read_envelopes(recording, info, {from, to}, _n, _limit) do
    with {:ok, rows} <- sample_stream(recording, info, from, to, @marks, envelopes: true),
         do: {:ok, Enum.map(rows, &elem(&1, 1))}
  end

  @doc """
  Returns about `n` or fewer messages between two times, evenly spaced by number, each with its position in the stream
  (adjacent messages differ by one).
  """
  @spec sample_messages(Recording.t(), Store.name(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, [{integer(), Message.t()}]} | {:error, Error.t()}
  def sample_messages(recording, name, from, to, n) do
    with {:ok, info} <- Store.stream_info(recording, name),
         do: sample_stream(recording, info, from, to, n)
  end

  defp sample_stream(recording, info, from, to, keep, opts \\ [])

  # The messages of several streams together are sampled by time. There may be others between them, so no two of them
  # have adjacent positions.
  defp sample_stream(recording, %{extra: %{bases: [_, _ | _]}} = info, from, to, keep, _opts) do
    messages =
      for i <- 1..keep//1,
          {:ok, message} <- [latest_at(recording, info, from + div((to - from) * i, keep))],
          message.originating_time >= from,
          do: message

    {:ok, messages |> Enum.dedup() |> Enum.with_index(&{2 * &2, &1})}
  end

  defp sample_stream(recording, info, from, to, keep, opts) do
    with {:ok, first} <- Store.ordinal(recording, info, from),
         {:ok, next} <- Store.ordinal(recording, info, to + 1) do
      n = max(next - first, 0)
      keep = min(n, keep)

      rows =
        for i <- 0..(keep - 1)//1,
            ordinal = first + div(i * n, keep),
            {:ok, %Message{} = message} <- [Store.at(recording, info, ordinal, opts)],
            message.originating_time in from..to,
            do: {ordinal, message}

      {:ok, Enum.dedup_by(rows, fn {_, message} -> message.originating_time end)}
    end
  end

  @doc "Returns the last message at or before a time."
  @spec latest_at(Recording.t(), Store.name(), Situ.Time.t()) ::
          {:ok, Message.t()} | :none | {:error, Error.t()}
  def latest_at(recording, name, time), do: nil_to_none(Store.latest_at(recording, name, time))

  @doc "Returns the first message after a time."
  @spec next_after(Recording.t(), Store.name(), Situ.Time.t()) ::
          {:ok, Message.t()} | :none | {:error, Error.t()}
  def next_after(recording, name, time),
    do: nil_to_none(Store.first_at(recording, name, time + 1))

  defp nil_to_none({:ok, nil}), do: :none
  defp nil_to_none(other), do: other

  @doc "Returns at most `n` messages before or after a time, nearest first; `[]` if the stream cannot be read."
  @spec list_neighbours(
          Recording.t(),
          Store.name(),
          :before | :after,
          Situ.Time.t(),
          pos_integer()
        ) ::
          [Message.t()]
  def list_neighbours(recording, name, side, time, n) do
    with {:ok, info} <- Store.stream_info(recording, name),
         {:error, _} <- read_neighbours(recording, info, side, time, n) do
      # Reading one by one returns the messages up to the first damaged one.
      collect_neighbours(recording, info, side, time, n)
    else
      {:ok, messages} -> messages
      {:error, _} -> []
    end
  end

  defp read_neighbours(recording, info, :after, time, n),
    do: Store.read(recording, info, from: time + 1, limit: n)

  defp read_neighbours(recording, info, :before, time, n) do
    with {:ok, here} <- Store.ordinal(recording, info, time),
         do: read_backwards(recording, info, time, here, n, n)
  end

  # Ordinals do not have a message each if old messages were deleted or the stream is computed.
  defp read_backwards(recording, info, time, here, n, span) do
    first = max(here - span, 0)

    with {:ok, messages} when length(messages) < n and first > 0 <-
           Store.read(recording, info, index: first, to: time - 1, limit: span) do
      read_backwards(recording, info, time, here, n, span * 4)
    else
      {:ok, messages} -> {:ok, messages |> Enum.reverse() |> Enum.take(n)}
      error -> error
    end
  end

  defp collect_neighbours(recording, info, side, time, n) do
    next = fn
      time when side == :before -> latest_at(recording, info, time - 1)
      time -> next_after(recording, info, time)
    end

    time
    |> Stream.unfold(fn time ->
      with {:ok, message} <- next.(time),
           do: {message, message.originating_time},
           else: (_ -> nil)
    end)
    |> Enum.take(n)
  end

  @doc "Returns the message whose originating time is nearest to `time`."
  @spec fetch_nearest(Recording.t(), Store.name(), Situ.Time.t()) ::
          {:ok, Message.t()} | :none | {:error, Error.t()}
  def fetch_nearest(recording, name, time) do
    case {latest_at(recording, name, time), next_after(recording, name, time)} do
      {{:ok, a}, {:ok, b}} ->
        {:ok, if(time - a.originating_time <= b.originating_time - time, do: a, else: b)}

      {{:ok, a}, _} ->
        {:ok, a}

      {_, {:ok, b}} ->
        {:ok, b}

      {other, _} ->
        other
    end
  end
end
