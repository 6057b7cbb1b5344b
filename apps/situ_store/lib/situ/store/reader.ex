defmodule Situ.Store.Reader do
  @moduledoc """
  The behaviour of a file format that opens, lists, seeks and replays like a store.

  Which file is read by which reader: `Situ.Store.Formats`.

  Messages of a stream are numbered 0, 1, 2 ... (ordinals). A reader meets untrusted bytes: it answers errors, makes no
  atoms, and bounds what it allocates.
  """
  alias Situ.Store.StreamInfo

  @type state :: term()
  @type error :: {:error, Situ.Error.t()}

  @doc "File name endings, lower case, with the dot."
  @callback extensions() :: [String.t()]
  @doc """
  For recordings that lie elsewhere: how their addresses begin, `["situ"]` for `situ://...`. `open/2` and `within/1`
  get the whole address.
  """
  @callback schemes() :: [String.t()]
  @doc """
  Where recordings are folders: the one that `path` means, a folder or the name of one, or `nil`. `open/2` gets the
  answer.
  """
  @callback resolve(Path.t()) :: Path.t() | nil
  @doc "The recordings of this kind that lie in this very folder, as `resolve/1` has them."
  @callback within(folder :: Path.t()) :: [Path.t()]
  @doc "Opens the file. Options are the reader's own."
  @callback open(Path.t(), opts :: keyword()) :: {:ok, state()} | error()
  @doc """
  `name`, `created` (ns or nil), `closed?`, `live?`, `damage` (a list of sentences, or of maps with `offset` and
  `why`).
  """
  @callback info(state()) :: map()
  @doc """
  The options for opening a recording that is copied into a store, so that nothing of it is lost. `times` chooses
  between the stamps in headers and the times of recording.
  """
  @callback import_options(times :: :header | :record) :: keyword()
  @doc "The streams there are now."
  @callback streams(state()) :: [StreamInfo.t()]
  @doc "One of them, found by its name without the others."
  @callback stream_named(state(), String.t()) :: {:ok, StreamInfo.t()} | error()
  @doc "The ordinal of the first message at or after `time`; the count when there is none."
  @callback seek(state(), StreamInfo.t(), Situ.Time.t()) ::
              {:ok, non_neg_integer()} | error()
  @doc """
  About `limit` messages from `ordinal` on that lie at or before `to`, and the ordinal to go on with. An empty list is
  the end for now. `exact: true` asks for no more than `limit`; with `envelopes: true` nobody looks at the data, and a
  reader that has to decode may leave it `nil`.
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
  Plain numbers from `ordinal` on that lie at or before `to`, as columns of some thousand messages, and the ordinal to
  go on with; `:others` where the next messages are no plain numbers, `:ended` where there are none.
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
  @doc "Min/max/last/count bins: `{:ok, width_ns, [{start, min, max, last, count}]}`."
  @callback summary(state(), StreamInfo.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
              {:ok, pos_integer(), [tuple()]} | error()
  @doc "Counts and tracks in bins of 2^level ns: `{:ok, counts, tracks}` of a `Situ.Store.Summary`."
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
  @doc "Sends one `{:situ_store, tag, {:published | :ended, n}}` once there is more than `known`."
  @callback await(state(), known :: non_neg_integer(), pid(), tag :: non_neg_integer()) :: :ok
  @doc "The number of messages now, without the rest of `streams/1`."
  @callback count(state(), StreamInfo.t()) :: non_neg_integer()
  @doc "Spans of at least `least` ns without a message."
  @callback gaps(state(), StreamInfo.t(), least :: Situ.Time.duration()) ::
              [{Situ.Time.t(), Situ.Time.t()}]
  @doc "Files that belong to the recording and are not there."
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
