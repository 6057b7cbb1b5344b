defmodule Situ.Store.Summary do
  @moduledoc """
  A stream as a timeline shows it, over any span, in milliseconds whatever its length.

    * `read/6`: everything that can be drawn of a stream of any type
    * `numbers/5`: the signal of numbers and of sound

  Time is cut into bins of a power of two nanoseconds, at most `(to - from) / pixels` wide, that start at the
  multiples of their width: panning reuses them. Bins are whole, so the first and the last may reach over the edges of
  the span; empty ones are left out.

  ## The result of `read/6`

  `%Situ.Store.Summary{width: ns, counts: [...], tracks: [...]}`:

    * `counts`: `{start, n}`, how many messages lie in each bin, exactly, for streams of any type
    * `tracks`: `{key, track}`, where `key` is `nil` for the message itself and else the map's (or struct's) key. A
      track is one of
      * `{:numbers, [{start, min, max, last, n}]}`
      * `{:changes, [{time, state}]}`: the exact times at which the state changed, where there are few (option
        `changes:`). The first one is the state in force at `from`, with the time of its message, which may lie before
      * `{:states, [{start, last, [{state, n}]}]}`: where there are many, how many messages of each bin had which
        state, exactly (the most frequent first), and the bin's last state

  States are booleans, atoms, `nil` and texts of up to 64 bytes. Maps and structs of up to 64 keys have a track for
  each key whose value is a number or a state, so a stream of intervals (`%{start: t0, stop: t1, label: "door"}`) has
  the numbers `:start` and `:stop` (the least `:start` and the greatest `:stop` of a bin tell what reaches into a
  window) and the states `:label`. A key that holds numbers at one time and states at another has two tracks (but for
  numbers among the truths of a stream, which have none). Beyond 256 different states of a key the further ones are
  counted as `:"$other"`. Everything else has counts only.

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
  alias Situ.Store.{Handle, Native, Reading, StreamInfo}
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
        "The most changes of a track that are returned one by one; more of them come as counts."
    ]
  ]

  @doc """
  Everything that can be drawn of a stream from `from` to `to` (both included) in `pixels` columns.

  #{Options.docs(@options)}
  """
  @spec read(
          Handle.t(),
          Reading.name(),
          Situ.Time.t(),
          Situ.Time.t(),
          pos_integer(),
          keyword()
        ) :: {:ok, t()} | {:error, Error.t()}
  def read(store, name, from, to, pixels, opts \\ [])
      when is_integer(from) and is_integer(to) and is_integer(pixels) and pixels > 0 do
    with {:ok, opts} <- Options.validate(opts, @options),
         {:ok, info} <- Reading.stream_info(store, name),
         level = Native.summary_level(from, to, pixels),
         {:ok, counts, tracks} <- tracks(store, info, from, to, level, opts[:changes]) do
      {:ok, %__MODULE__{width: Bitwise.bsl(1, level), counts: counts, tracks: tracks}}
    end
  end

  defp tracks(store, info, from, to, level, changes) do
    if function_exported?(store.module, :tracks, 6),
      do: store.module.tracks(store.state, info, from, to, level, changes),
      else: Fold.tracks(store, info, from, to, level, changes)
  end

  @doc """
  The signal of a numeric or audio stream over `from..to`, folded for `pixels` columns: `{:ok, width, bins}` with bins
  `{start, min, max, last, count}`. Booleans are 0 and 1, integers come as floats. For sound the bins are those of its
  samples.
  """
  @spec numbers(Handle.t(), Reading.name(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
          {:ok, width :: pos_integer(), [bin()]} | {:error, Error.t()}
  def numbers(store, name, from, to, pixels)
      when is_integer(from) and is_integer(to) and is_integer(pixels) and pixels > 0 do
    with {:ok, %StreamInfo{} = info} <- Reading.stream_info(store, name) do
      if function_exported?(store.module, :summary, 5),
        do: store.module.summary(store.state, info, from, to, pixels),
        else: Fold.numbers(store, info, from, to, Native.summary_level(from, to, pixels))
    end
  end
end
