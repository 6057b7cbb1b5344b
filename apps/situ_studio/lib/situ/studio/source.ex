defmodule Situ.Studio.Source do
  @moduledoc """
  Defines sources of streams: a store on disk, a store that is being written, or a running pipeline. The studio reads
  all data through these functions; handles are plain terms that any process can use.

  Times are inclusive at both ends. A source that is gone returns `{:error, error}` and the page shows the error.
  """
  alias Situ.Studio.{Source, StreamInfo}

  @typedoc "A source's module and handle."
  @type t :: {module(), handle :: term()}
  @type extent :: %{
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          live: boolean(),
          version: non_neg_integer()
        }

  @doc "Returns the first and last time, whether the source is live, and a version that changes when streams are added."
  @callback extent(handle :: term()) :: {:ok, extent()} | {:error, Situ.Error.t()}

  @doc "Returns the streams of the source."
  @callback streams(handle :: term()) :: {:ok, [StreamInfo.t()]} | {:error, Situ.Error.t()}

  @doc """
  Returns the signal of a numeric or audio stream between two times in bins of `bin` ns, or message by message if
  there are fewer messages than bins. Includes the neighbors just outside, so that lines reach the edges.
  """
  @callback series(
              handle :: term(),
              stream :: String.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              bin :: pos_integer()
            ) ::
              {:ok, [Situ.Codec.point()], raw? :: boolean()} | {:error, Situ.Error.t()}

  @doc "Returns at most `limit` messages between two times, in order, and `:more` if there are more."
  @callback messages(
              handle :: term(),
              stream :: String.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              limit :: pos_integer()
            ) :: {:ok, [Situ.Message.t()], :all | :more} | {:error, Situ.Error.t()}

  @doc "Returns times and latencies of at most `limit` messages; if there are more, evenly thinned and with `:more`."
  @callback marks(
              handle :: term(),
              stream :: String.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              limit :: pos_integer()
            ) ::
              {:ok, [{Situ.Time.t(), Situ.Time.duration()}], :all | :more}
              | {:error, Situ.Error.t()}

  @doc "Returns the last message at or before a time."
  @callback latest_at(handle :: term(), stream :: String.t(), Situ.Time.t()) ::
              {:ok, Situ.Message.t()} | :none | {:error, Situ.Error.t()}

  @doc "Returns the first message after a time."
  @callback next_after(handle :: term(), stream :: String.t(), Situ.Time.t()) ::
              {:ok, Situ.Message.t()} | :none | {:error, Situ.Error.t()}

  @doc """
  Returns about `n` or fewer messages between two times, evenly spaced by number, each with its position in the stream
  (adjacent messages differ by one). Without this callback, the sample is evenly spaced in time.
  """
  @callback sample(
              handle :: term(),
              stream :: String.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              n :: pos_integer()
            ) :: {:ok, [{integer(), Situ.Message.t()}]} | {:error, Situ.Error.t()}

  @doc """
  Returns a summary of many messages without reading them (`Situ.Store.Summary.read/6`), or `:none` if there are so
  few messages that reading them is better.
  """
  @callback summary(
              handle :: term(),
              stream :: String.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              bins :: pos_integer()
            ) :: {:ok, Situ.Store.Summary.t()} | :none | {:error, Situ.Error.t()}

  @doc "Returns descriptions of the damage of the source; `[]` if it is fully readable."
  @callback damage(handle :: term()) :: [String.t()]

  @doc """
  Announces the streams that a page shows, even if it does not request data at the moment. A source that captures
  streams on demand keeps capturing them.
  """
  @callback wanted(handle :: term(), streams :: [String.t()]) :: term()

  @doc "Returns at most `n` messages before or after a time, nearest first; for sources that can read many together."
  @callback neighbours(
              handle :: term(),
              stream :: String.t(),
              :before | :after,
              Situ.Time.t(),
              n :: pos_integer()
            ) :: {:ok, [Situ.Message.t()]} | {:error, Situ.Error.t()}

  @optional_callbacks sample: 5, summary: 5, damage: 1, wanted: 2, neighbours: 5

  @doc "Calls a function of the source."
  @spec call(t(), atom(), list()) :: term()
  def call({module, handle}, function, args), do: apply(module, function, [handle | args])

  @doc "Announces the streams that a page shows, see `c:wanted/2`."
  @spec request_streams(t(), [String.t()]) :: :ok
  def request_streams({module, handle}, streams) do
    if streams != [] and function_exported?(module, :wanted, 2),
      do: module.wanted(handle, streams)

    :ok
  end

  @doc "Returns the damage of the source, see `c:damage/1`."
  @spec list_damage(t()) :: [String.t()]
  def list_damage({module, handle}) do
    if function_exported?(module, :damage, 1), do: module.damage(handle), else: []
  end

  @doc "Returns the summary of a stream, see `c:summary/5`, or `:none` if the source does not support summaries."
  @spec fetch_summary(t(), String.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, Situ.Store.Summary.t()} | :none | {:error, Situ.Error.t()}
  def fetch_summary({module, handle}, stream, from, to, bins) do
    if function_exported?(module, :summary, 5),
      do: module.summary(handle, stream, from, to, bins),
      else: :none
  end

  @doc "Returns about `n` or fewer messages between two times with their positions, see `c:sample/5`."
  @spec sample_messages(t(), String.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, [{integer(), Situ.Message.t()}]} | {:error, Situ.Error.t()}
  def sample_messages({module, handle} = source, stream, from, to, n) do
    if function_exported?(module, :sample, 5),
      do: module.sample(handle, stream, from, to, n),
      else: {:ok, sample_by_time(source, stream, from, to, n)}
  end

  # Messages between the samples are unknown, so positions differ by two: no two samples count as adjacent.
  defp sample_by_time(source, stream, from, to, n) do
    messages =
      for i <- 1..n,
          {:ok, message} <- [
            Source.call(source, :latest_at, [stream, from + div((to - from) * i, n)])
          ],
          message.originating_time >= from,
          uniq: true,
          do: message

    Enum.with_index(messages, &{2 * &2, &1})
  end

  @doc """
  Returns at most `n` messages before or after a time, nearest first; `[]` if the stream cannot be read. See
  `c:neighbours/5`.
  """
  @spec list_neighbours(t(), String.t(), :before | :after, Situ.Time.t(), pos_integer()) ::
          [Situ.Message.t()]
  def list_neighbours({module, handle} = source, stream, side, time, n) do
    with true <- function_exported?(module, :neighbours, 5),
         {:ok, messages} <- module.neighbours(handle, stream, side, time, n) do
      messages
    else
      # Reading one by one returns the messages up to the first damaged one.
      _ -> collect_neighbours(source, stream, side, time, n)
    end
  end

  defp collect_neighbours(source, stream, side, time, n) do
    next = fn
      time when side == :before -> call(source, :latest_at, [stream, time - 1])
      time -> call(source, :next_after, [stream, time])
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
  @spec fetch_nearest(t(), String.t(), Situ.Time.t()) ::
          {:ok, Situ.Message.t()} | :none | {:error, Situ.Error.t()}
  def fetch_nearest(source, stream, time) do
    before = Source.call(source, :latest_at, [stream, time])
    later = Source.call(source, :next_after, [stream, time])

    case {before, later} do
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
