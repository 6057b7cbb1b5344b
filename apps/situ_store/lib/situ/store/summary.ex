defmodule Situ.Store.Summary do
  @moduledoc """
  Summarizes a stream for a timeline, over any time span and within milliseconds, regardless of the stream's length.

    * `read/6`: all drawable data of a stream of any type
    * `read_numbers/5`: the signal of numbers and of audio

  Time is divided into bins whose width is a power of two nanoseconds, at most `(to - from) / pixels`. Bins start at
  multiples of their width, so panning reuses them. Bins are always complete, so the first and the last may extend past
  the span. Empty bins are omitted.

  ## The result of `read/6`

  `%Situ.Store.Summary{width: ns, counts: [...], tracks: [...]}`:

    * `counts`: `{start, n}`, the exact number of messages in each bin, for streams of any type
    * `tracks`: `{key, track}`, where `key` is `nil` for the message itself, or else a key of the map (or struct). Each
      track has one of these forms:
      * `{:numbers, [{start, min, max, last, n}]}`
      * `{:changes, [{time, state}]}`: the exact times at which the state changed, if there are few changes (option
        `changes:`). The first entry is the state in force at `from`, with the time of its message, which may be earlier
      * `{:states, [{start, last, [{state, n}]}]}`: if there are many changes, the last state of each bin and the exact
        number of messages with each state, most frequent first

  States are booleans, atoms, `nil` and strings of up to 64 bytes. Maps and structs of up to 64 keys have a track for
  each key whose value is a number or a state. For example, a stream of intervals (`%{start: t0, stop: t1, label:
  "door"}`) has the numbers `:start` and `:stop` and the states `:label`. The smallest `:start` and the largest `:stop`
  of a bin show whether its intervals reach into a window. A key that has numbers at one time and states at another has
  two tracks. As an exception, numbers in a stream that also contains booleans have no track. After 256 different states
  of a key, further states are counted as `:"$other"`. All other data has counts only.

      iex> root = Path.join(System.tmp_dir!(), "situ-doc-summary")
      iex> {:ok, writer} = Situ.Store.Writer.create("door", root)
      iex> {:ok, stream} = Situ.Store.Writer.stream(writer, "Open", type: :boolean)
      iex> messages = for {open?, i} <- Enum.with_index([false, false, true, true, false]),
      ...>   do: %Situ.Message{data: open?, originating_time: i * 1_000, creation_time: i * 1_000, sequence_id: i}
      iex> {:ok, _} = Situ.Store.Writer.append(stream, messages)
      iex> :ok = Situ.Store.Writer.close(writer)
      iex> store = Situ.Store.open!(writer.path)
      iex> {:ok, summary} = Situ.Store.Summary.read(store, "Open", 0, 4_000, 2)
      iex> {summary.width, summary.counts}
      {1024, [{0, 2}, {1024, 1}, {2048, 1}, {3072, 1}]}
      iex> summary.tracks
      [{nil, {:changes, [{0, false}, {2_000, true}, {4_000, false}]}}]
      iex> {:ok, %{tracks: tracks}} = Situ.Store.Summary.read(store, "Open", 0, 4_000, 1, changes: 1)
      iex> tracks
      [{nil, {:states, [{0, true, [{false, 2}, {true, 1}]}, {2048, false, [{true, 1}, {false, 1}]}]}}]
      iex> Situ.Store.delete(store.path)
      :ok
  """
  alias Situ.{Error, Options}
  alias Situ.Recording
  alias Situ.Store.{Native, Query, StreamInfo}
  alias Situ.Store.Summary.Fold

  @enforce_keys [:width, :counts, :tracks]
  defstruct [:width, :counts, :tracks]

  @type bin ::
          {start :: Situ.Time.t(), min :: float(), max :: float(), last :: float(),
           count :: pos_integer()}
  @type state :: boolean() | atom() | String.t()
  @type track ::
          {:numbers, [bin()]}
          | {:changes, [{Situ.Time.t(), state()}]}
          | {:states, [{start :: Situ.Time.t(), last :: state(), [{state(), pos_integer()}]}]}
  @type t :: %__MODULE__{
          width: pos_integer(),
          counts: [{start :: Situ.Time.t(), pos_integer()}],
          tracks: [{key :: term(), track()}]
        }

  @options [
    changes: [
      type: :non_neg_integer,
      default: 100,
      doc:
        "The maximum number of changes of a track that are returned individually; above it, states are counted."
    ]
  ]

  @doc """
  Returns all drawable data of a stream from `from` to `to` (both included) in `pixels` columns.

  #{Options.docs(@options)}
  """
  @spec read(
          Recording.t(),
          Query.name(),
          Situ.Time.t(),
          Situ.Time.t(),
          pos_integer(),
          keyword()
        ) :: {:ok, t()} | {:error, Error.t()}
  def read(store, name, from, to, pixels, opts \\ [])
      when is_integer(from) and is_integer(to) and is_integer(pixels) and pixels > 0 do
    with {:ok, opts} <- Options.validate(opts, @options),
         {:ok, info} <- Query.stream_info(store, name),
         level = Native.summary_level(from, to, pixels),
         {:ok, counts, tracks} <- read_tracks(store, info, from, to, level, opts[:changes]) do
      {:ok, %__MODULE__{width: Bitwise.bsl(1, level), counts: counts, tracks: tracks}}
    end
  end

  @doc """
  Returns the counts and tracks of `read/6` in bins of 2^level ns. Lists up to `changes` changes of a track
  individually.
  """
  @spec read_tracks(
          Recording.t(),
          StreamInfo.t(),
          Situ.Time.t(),
          Situ.Time.t(),
          level :: non_neg_integer(),
          changes :: non_neg_integer()
        ) ::
          {:ok, [{Situ.Time.t(), pos_integer()}], [{term(), track()}]} | {:error, Error.t()}
  def read_tracks(store, info, from, to, level, changes) do
    with :none <- call_optional(store, :tracks, [info, from, to, level, changes]),
         do: Fold.fold_tracks(store, info, from, to, level, changes)
  end

  defp call_optional(%{module: module, state: state} = store, callback, args) do
    if Recording.implements?(store, callback, length(args) + 1),
      do: apply(module, callback, [state | args]),
      else: :none
  end

  @doc """
  Returns the signal of a numeric or audio stream over `from..to` for `pixels` columns: `{:ok, width, bins}` with bins
  `{start, min, max, last, count}`. Booleans are 0 and 1, and integers are returned as floats. The bins of audio are
  computed from its samples.
  """
  @spec read_numbers(Recording.t(), Query.name(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, width :: pos_integer(), [bin()]} | {:error, Error.t()}
  def read_numbers(store, name, from, to, pixels)
      when is_integer(from) and is_integer(to) and is_integer(pixels) and pixels > 0 do
    with {:ok, %StreamInfo{} = info} <- Query.stream_info(store, name),
         :none <- call_optional(store, :summary, [info, from, to, pixels]),
         do: Fold.fold_numbers(store, info, from, to, Native.summary_level(from, to, pixels))
  end
end
