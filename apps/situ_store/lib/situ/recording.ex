defmodule Situ.Recording do
  @moduledoc """
  An open recording, and the behaviour of everything that can be read by time: stores, files of other formats,
  recordings on other machines, and the studio's sessions, comparisons and running pipelines.

  `Situ.Store` has the functions that read any recording. A recording is plain data: any process may use it, and it does
  not need to be closed.

    * `path`: the folder, file or address; `nil` if the recording does not have one
    * `module`, `state`: the module that implements this behaviour, and its state

  A module returns its streams, the ordinal of a time, and the messages from an ordinal on. Everything else (the latest
  message at a time, messages in a window, counts, summaries) follows from these, and a module implements the optional
  callbacks only where it can do better.

  Messages of a stream are numbered 0, 1, 2 ... (ordinals). Ordinals begin above 0 if old messages are deleted, and an
  ordinal without a message stands for the next one. A module processes untrusted bytes, so it must return errors,
  create no atoms, and bound its memory use. `info/1` and `streams/1` raise the `Situ.Error` of a recording that has
  gone.

  A file format implements `Situ.Recording.Format`, too.
  """
  alias Situ.Store.StreamInfo

  @enforce_keys [:module, :state]
  defstruct [:path, :module, :state]
  @type t :: %__MODULE__{path: Path.t() | nil, module: module(), state: state()}

  @type state :: term()
  @type error :: {:error, Situ.Error.t()}

  @doc """
  Returns `name`, `created` (ns or nil), `closed?`, `live?`, `damage` (a list of sentences, of maps with `offset` and
  `why`, or of `{file, position, why}`; `describe_damage/1` formats each). A recording of a running clock returns its
  time as `now`.
  """
  @callback info(state()) :: map()
  @doc "Returns the current streams."
  @callback streams(state()) :: [StreamInfo.t()]
  @doc "Returns the ordinal of the first message at or after `time`, or the next new ordinal if there is none."
  @callback seek(state(), StreamInfo.t(), Situ.Time.t()) ::
              {:ok, non_neg_integer()} | error()
  @doc """
  Reads about `limit` messages at or before `to`, starting at `ordinal`, and returns them with the next ordinal. An
  empty list means that there are no more messages yet. `exact: true` requests at most `limit` messages. With
  `envelopes: true`, the caller ignores the data, and a module that would have to decode it may leave it `nil`. `total:`
  is the number of messages that the caller wants in all, if it knows.
  """
  @callback read(
              state(),
              StreamInfo.t(),
              ordinal :: non_neg_integer(),
              to :: Situ.Time.t() | :unbounded,
              limit :: pos_integer(),
              opts :: keyword()
            ) :: {:ok, [Situ.Message.t()], non_neg_integer()} | error()
  @doc "Returns one stream by name without loading the others."
  @callback stream(state(), String.t()) :: {:ok, StreamInfo.t()} | error()
  @doc """
  Returns the last message at or before a time, or `nil`, for a module for which `c:seek/3` and `c:read/6` are slow.
  """
  @callback latest_at(state(), StreamInfo.t(), Situ.Time.t()) ::
              {:ok, Situ.Message.t() | nil} | error()
  @doc "Returns the current number of messages without the other statistics of `streams/1`."
  @callback count(state(), StreamInfo.t()) :: non_neg_integer()
  @doc """
  Returns min/max/last/count bins: `{:ok, width_ns, [{start, min, max, last, count}]}`, or `:none` for a stream that has
  to be read to be summarized.
  """
  @callback summary(state(), StreamInfo.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
              {:ok, pos_integer(), [tuple()]} | :none | error()
  @doc """
  Returns counts and tracks in bins of 2^level ns: `{:ok, counts, tracks}` of a `Situ.Store.Summary`, or `:none` like
  `c:summary/5`.
  """
  @callback tracks(
              state(),
              StreamInfo.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              level :: non_neg_integer(),
              most_changes :: non_neg_integer()
            ) ::
              {:ok, [{Situ.Time.t(), pos_integer()}], [{term(), Situ.Store.Summary.track()}]}
              | :none
              | error()
  @doc """
  Reads plain numbers at or before `to`, starting at `ordinal`, as columns from about `bytes` of the file, and returns
  them with the next ordinal. Returns `:others` if the next messages are not plain numbers, or `:ended` if there are
  none.
  """
  @callback columns(
              state(),
              StreamInfo.t(),
              ordinal :: non_neg_integer(),
              to :: Situ.Time.t(),
              bytes :: pos_integer()
            ) :: {:ok, Situ.Columns.t(), non_neg_integer()} | :others | :ended | error()
  @doc "Returns spans of at least `least` ns without a message."
  @callback gaps(state(), StreamInfo.t(), least :: Situ.Time.duration()) ::
              [{Situ.Time.t(), Situ.Time.t()}]
  @doc """
  Appends the messages of several streams in an interval to streams of a store, in one pass over the file. Calls the
  function with the number of messages after every part.
  """
  @callback append_streams(
              state(),
              [{StreamInfo.t(), Situ.Store.Writer.Stream.t()}],
              {from :: Situ.Time.t(), to :: Situ.Time.t()},
              (pos_integer() -> any())
            ) :: :ok | error()
  @doc "Returns the files that belong to the recording but do not exist."
  @callback missing_files(state()) :: [String.t()]
  @doc """
  Announces the streams that somebody watches, even if nobody reads them at the moment. A recording that captures
  streams on demand keeps capturing them.
  """
  @callback request_streams(state(), names :: [String.t()]) :: term()
  @doc """
  Describes the compressed images of a stream (`Situ.Recording.CodedVideo`). Returns `:none` if it does not have any,
  and an error if they cannot be decoded from their packets.
  """
  @callback coded_video(state(), StreamInfo.t()) ::
              {:ok, Situ.Recording.CodedVideo.t()} | :none | error()
  @doc "Returns the bytes of packets of compressed images."
  @callback coded_packets(
              state(),
              StreamInfo.t(),
              first :: non_neg_integer(),
              count :: non_neg_integer()
            ) :: {:ok, [binary()]} | error()
  @doc "Sends one `{:situ_store, tag, {:published | :ended, n}}` when there are more than `known` entries."
  @callback notify(state(), known :: non_neg_integer(), pid(), tag :: non_neg_integer()) :: :ok

  @optional_callbacks stream: 2,
                      latest_at: 3,
                      count: 2,
                      summary: 5,
                      tracks: 6,
                      columns: 5,
                      gaps: 3,
                      append_streams: 4,
                      missing_files: 1,
                      request_streams: 2,
                      coded_video: 2,
                      coded_packets: 4,
                      notify: 4

  @doc """
  Describes an entry of the `damage` of `Situ.Store.info/1`.

      iex> Situ.Recording.describe_damage({"walk.csv", 3, "line 3: the time is missing"})
      "walk.csv: line 3: the time is missing"
      iex> Situ.Recording.describe_damage(%{offset: 64, why: "a chunk is cut short"})
      "at byte 64: a chunk is cut short"
  """
  @spec describe_damage(String.t() | map() | {String.t(), non_neg_integer(), String.t()}) ::
          String.t()
  def describe_damage(sentence) when is_binary(sentence), do: sentence
  def describe_damage({file, _position, why}), do: "#{Path.basename(file)}: #{why}"
  def describe_damage(%{offset: offset, why: why}), do: "at byte #{offset}: #{why}"

  @doc "Returns whether the recording's module implements an optional callback."
  @spec implements?(t(), atom(), arity()) :: boolean()
  def implements?(%__MODULE__{module: module}, callback, arity),
    do: function_exported?(module, callback, arity)

  defimpl Inspect do
    def inspect(%{path: nil}, _opts), do: "#Situ.Recording<in memory>"
    def inspect(%{path: path}, _opts), do: "#Situ.Recording<#{Kernel.inspect(path)}>"
  end
end
