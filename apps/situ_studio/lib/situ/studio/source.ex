defmodule Situ.Studio.Source do
  @moduledoc """
  Where streams come from: a store on disk, a store being written, a running pipeline. Everything the studio draws is
  asked of a source through these functions; handles are plain terms usable from any process.

  Times are inclusive at both ends. A source that is gone answers `{:error, error}` and the page shows the error.
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

  @doc "First and last time, whether it grows, and a number that changes with the list of streams."
  @callback extent(handle :: term()) :: {:ok, extent()} | {:error, Situ.Error.t()}

  @doc "The streams of the source."
  @callback streams(handle :: term()) :: {:ok, [StreamInfo.t()]} | {:error, Situ.Error.t()}

  @doc """
  The signal of a numeric or audio stream between two times in bins `bin` ns wide, or message by message where there are
  fewer; with the neighbours just outside, so that lines reach the edges.
  """
  @callback series(
              handle :: term(),
              stream :: String.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              bin :: pos_integer()
            ) ::
              {:ok, [Situ.Codec.point()], raw? :: boolean()} | {:error, Situ.Error.t()}

  @doc "At most `limit` messages between two times, in order; `:more` when there are more."
  @callback messages(
              handle :: term(),
              stream :: String.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              limit :: pos_integer()
            ) :: {:ok, [Situ.Message.t()], :all | :more} | {:error, Situ.Error.t()}

  @doc "Times and latencies of at most `limit` messages; when there are more, evenly thinned and `:more`."
  @callback marks(
              handle :: term(),
              stream :: String.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              limit :: pos_integer()
            ) ::
              {:ok, [{Situ.Time.t(), Situ.Time.duration()}], :all | :more}
              | {:error, Situ.Error.t()}

  @doc "The last message at or before a time."
  @callback latest_at(handle :: term(), stream :: String.t(), Situ.Time.t()) ::
              {:ok, Situ.Message.t()} | :none | {:error, Situ.Error.t()}

  @doc "The first message after a time."
  @callback next_after(handle :: term(), stream :: String.t(), Situ.Time.t()) ::
              {:ok, Situ.Message.t()} | :none | {:error, Situ.Error.t()}

  @doc """
  At most about `n` messages of those between two times, evenly by number, each with its place in the stream (neighbours
  differ by one). Where it is missing, the sample is taken evenly over the time.
  """
  @callback sample(
              handle :: term(),
              stream :: String.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              n :: pos_integer()
            ) :: {:ok, [{integer(), Situ.Message.t()}]} | {:error, Situ.Error.t()}

  @doc """
  A summary of many messages without reading them (`Situ.Store.Summary.read/6`), or `:none` if there are so few that
  reading them is better.
  """
  @callback summary(
              handle :: term(),
              stream :: String.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              bins :: pos_integer()
            ) :: {:ok, Situ.Store.Summary.t()} | :none | {:error, Situ.Error.t()}

  @doc "The damage of the source, in sentences; `[]` if all of it can be read."
  @callback damage(handle :: term()) :: [String.t()]

  @doc """
  A page shows these streams, whether it asks for any of them at the moment or not: a source that reads only what
  somebody wants goes on with them.
  """
  @callback wanted(handle :: term(), streams :: [String.t()]) :: term()

  @doc "At most `n` messages before a time or after it, the nearest first; for sources that have many at once."
  @callback neighbours(
              handle :: term(),
              stream :: String.t(),
              :before | :after,
              Situ.Time.t(),
              n :: pos_integer()
            ) :: {:ok, [Situ.Message.t()]} | {:error, Situ.Error.t()}

  @optional_callbacks sample: 5, summary: 5, damage: 1, wanted: 2, neighbours: 5

  @doc "Calls the source's function of this name."
  @spec call(t(), atom(), list()) :: term()
  def call({module, handle}, function, args), do: apply(module, function, [handle | args])

  @doc "Tells the source which streams a page shows, see `c:wanted/2`."
  @spec wanted(t(), [String.t()]) :: :ok
  def wanted({module, handle}, streams) do
    if streams != [] and function_exported?(module, :wanted, 2),
      do: module.wanted(handle, streams)

    :ok
  end

  @doc "The damage of the source, see `c:damage/1`."
  @spec damage(t()) :: [String.t()]
  def damage({module, handle}) do
    if function_exported?(module, :damage, 1), do: module.damage(handle), else: []
  end

  @doc "The summary of a stream, see `c:summary/5`; `:none` where the source makes none."
  @spec summary(t(), String.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, Situ.Store.Summary.t()} | :none | {:error, Situ.Error.t()}
  def summary({module, handle}, stream, from, to, bins) do
    if function_exported?(module, :summary, 5),
      do: module.summary(handle, stream, from, to, bins),
      else: :none
  end

  @doc "At most about `n` messages of those between two times, with their places, see `c:sample/5`."
  @spec sample(t(), String.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, [{integer(), Situ.Message.t()}]} | {:error, Situ.Error.t()}
  def sample({module, handle} = source, stream, from, to, n) do
    if function_exported?(module, :sample, 5),
      do: module.sample(handle, stream, from, to, n),
      else: {:ok, over_time(source, stream, from, to, n)}
  end

  # Nobody knows what lies between them: no two are neighbours.
  defp over_time(source, stream, from, to, n) do
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
  At most `n` messages before a time or after it, the nearest first; `[]` of a stream that cannot be read. See
  `c:neighbours/5`.
  """
  @spec neighbours(t(), String.t(), :before | :after, Situ.Time.t(), pos_integer()) ::
          [Situ.Message.t()]
  def neighbours({module, handle} = source, stream, side, time, n) do
    with true <- function_exported?(module, :neighbours, 5),
         {:ok, messages} <- module.neighbours(handle, stream, side, time, n) do
      messages
    else
      # up to what is damaged
      _ -> one_by_one(source, stream, side, time, n)
    end
  end

  defp one_by_one(source, stream, side, time, n) do
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

  @doc "The message whose originating time is nearest to `time`."
  @spec nearest(t(), String.t(), Situ.Time.t()) ::
          {:ok, Situ.Message.t()} | :none | {:error, Situ.Error.t()}
  def nearest(source, stream, time) do
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
