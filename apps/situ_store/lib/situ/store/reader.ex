defmodule Situ.Store.Reader do
  @moduledoc """
  The behaviour of file formats that support opening, listing, seeking and replaying like a store.

  `Situ.Store.Formats` chooses the reader for a file.

  Messages of a stream are numbered 0, 1, 2 ... (ordinals). A reader processes untrusted bytes, so it must return
  errors, create no atoms, and bound its memory use.
  """
  alias Situ.Store.StreamInfo

  @type state :: term()
  @type error :: {:error, Situ.Error.t()}

  @doc "Returns the file name extensions in lower case, with the dot."
  @callback extensions() :: [String.t()]
  @doc """
  Returns the schemes of addresses of remote recordings, such as `["situ"]` for `situ://...`. `open/2` and `within/1`
  receive the complete address.
  """
  @callback schemes() :: [String.t()]
  @doc """
  Resolves `path`, a folder or the name of one, to a recording that is a folder, or returns `nil`. `open/2` receives the
  result.
  """
  @callback resolve(Path.t()) :: Path.t() | nil
  @doc "Lists the recordings of this format directly in this folder, in the form that `resolve/1` returns."
  @callback within(folder :: Path.t()) :: [Path.t()]
  @doc "Opens the file. The options are specific to the reader."
  @callback open(Path.t(), opts :: keyword()) :: {:ok, state()} | error()
  @doc """
  Returns `name`, `created` (ns or nil), `closed?`, `live?`, `damage` (a list of sentences, or of maps with `offset` and
  `why`).
  """
  @callback info(state()) :: map()
  @doc """
  Returns the options for opening a recording to copy it into a store without loss. `times` selects the timestamps in
  headers or the times of recording.
  """
  @callback import_options(times :: :header | :record) :: keyword()
  @doc "Returns the current streams."
  @callback streams(state()) :: [StreamInfo.t()]
  @doc "Returns one stream by name without loading the others."
  @callback stream_named(state(), String.t()) :: {:ok, StreamInfo.t()} | error()
  @doc "Returns the ordinal of the first message at or after `time`, or the message count if there is none."
  @callback seek(state(), StreamInfo.t(), Situ.Time.t()) ::
              {:ok, non_neg_integer()} | error()
  @doc """
  Reads about `limit` messages at or before `to`, starting at `ordinal`, and returns them with the next ordinal. An
  empty list means that there are no more messages yet. `exact: true` requests at most `limit` messages. With
  `envelopes: true`, the caller ignores the data, and a reader that would have to decode it may leave it `nil`.
  """
  @callback read(
              state(),
              StreamInfo.t(),
              ordinal :: non_neg_integer(),
              to :: Situ.Time.t(),
              limit :: pos_integer(),
              opts :: keyword()
            ) :: {:ok, [Situ.Message.t()], non_neg_integer()} | error()
  @doc """
  Reads plain numbers at or before `to`, starting at `ordinal`, as columns of several thousand messages, and returns
  them with the next ordinal. Returns `:others` if the next messages are not plain numbers, or `:ended` if there are
  none.
  """
  @callback columns(state(), StreamInfo.t(), ordinal :: non_neg_integer(), to :: Situ.Time.t()) ::
              {:ok, Situ.Store.Columns.t(), non_neg_integer()} | :others | :ended | error()
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
  @doc "Returns min/max/last/count bins: `{:ok, width_ns, [{start, min, max, last, count}]}`."
  @callback summary(state(), StreamInfo.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
              {:ok, pos_integer(), [tuple()]} | error()
  @doc "Returns counts and tracks in bins of 2^level ns: `{:ok, counts, tracks}` of a `Situ.Store.Summary`."
  @callback tracks(
              state(),
              StreamInfo.t(),
              Situ.Time.t(),
              Situ.Time.t(),
              level :: non_neg_integer(),
              most_changes :: non_neg_integer()
            ) ::
              {:ok, [{Situ.Time.t(), pos_integer()}], [{term(), Situ.Store.Summary.track()}]}
              | error()
  @doc "Sends one `{:situ_store, tag, {:published | :ended, n}}` when there are more than `known` entries."
  @callback await(state(), known :: non_neg_integer(), pid(), tag :: non_neg_integer()) :: :ok
  @doc "Returns the current number of messages without the other statistics of `streams/1`."
  @callback count(state(), StreamInfo.t()) :: non_neg_integer()
  @doc "Returns spans of at least `least` ns without a message."
  @callback gaps(state(), StreamInfo.t(), least :: Situ.Time.duration()) ::
              [{Situ.Time.t(), Situ.Time.t()}]
  @doc "Returns the files that belong to the recording but do not exist."
  @callback missing_files(state()) :: [String.t()]

  @optional_callbacks import_options: 1,
                      stream_named: 2,
                      schemes: 0,
                      resolve: 1,
                      within: 1,
                      columns: 4,
                      append_streams: 4,
                      summary: 5,
                      tracks: 6,
                      await: 4,
                      count: 2,
                      gaps: 3,
                      missing_files: 1
end
