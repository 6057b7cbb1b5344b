defmodule Situ.Store.Reader do
  @moduledoc """
  What a file format must answer so that it opens, lists, seeks and replays like a store.

  A reader is found by the file's extension (`extensions/0`): first those named in the configuration,

      config :situ_store, readers: [MyFormat]

  then those that a loaded application brings (`env: [store_readers: [MyFormat]]` in `application/0` of its `mix.exs`), then CSV,
  which is built in.

  Messages of a stream are numbered 0, 1, 2 ... (ordinals). A reader meets untrusted bytes: it answers errors, makes no
  atoms, and bounds what it allocates.
  """
  alias Situ.Store.StreamInfo

  @type state :: term()
  @type error :: {:error, Situ.Error.t()}

  @doc "File name endings, lower case, with the dot."
  @callback extensions() :: [String.t()]
  @doc """
  Where recordings are folders: the one that `path` means, a folder or the name of one, or `nil`. `open/2` gets the answer.
  """
  @callback resolve(Path.t()) :: Path.t() | nil
  @doc "The recordings of this kind that lie in this very folder, as `resolve/1` has them."
  @callback within(folder :: Path.t()) :: [Path.t()]
  @doc "Opens the file. Options are the reader's own."
  @callback open(Path.t(), opts :: keyword()) :: {:ok, state()} | error()
  @doc "`name`, `created` (ns or nil), `closed?`, `live?`, `damage` (list)."
  @callback info(state()) :: map()
  @doc "The streams there are now."
  @callback streams(state()) :: [StreamInfo.t()]
  @doc "The ordinal of the first message at or after `time`; the count when there is none."
  @callback seek(state(), StreamInfo.t(), Situ.Time.t()) ::
              {:ok, non_neg_integer()} | error()
  @doc """
  About `limit` messages from `ordinal` on that lie at or before `to`, and the ordinal to go on with. An empty list is
  the end for now. `exact: true` asks for no more than `limit`; with `envelopes: true` nobody looks at the data, and a reader that
  has to decode may leave it `nil`.
  """
  @callback read(
              state(),
              StreamInfo.t(),
              ordinal :: non_neg_integer(),
              to :: Situ.Time.t(),
              limit :: pos_integer(),
              opts :: keyword()
            ) :: {:ok, [Situ.Message.t()], non_neg_integer()} | error()
  @doc "Min/max/last/count bins: `{:ok, width_ns, [{start, min, max, last, count}]}`."
  @callback summary(state(), StreamInfo.t(), Situ.Time.t(), Situ.Time.t(), pos_integer()) ::
              {:ok, pos_integer(), [tuple()]} | error()
  @doc "Sends one `{:situ_store, tag, {:published | :ended, n}}` once there is more than `known`."
  @callback await(state(), known :: non_neg_integer(), pid(), tag :: non_neg_integer()) :: :ok
  @callback close(state()) :: any()

  @optional_callbacks summary: 5, await: 4, close: 1, resolve: 1, within: 1

  @built_in [Situ.Store.Csv]

  @doc "The reader for a file, or `nil`."
  @spec for_file(Path.t()) :: module() | nil
  def for_file(path) do
    extension = path |> Path.extname() |> String.downcase()
    Enum.find(all(), &(extension in &1.extensions()))
  end

  @doc "The reader whose recordings are folders and what `path` means to it, or `nil`."
  @spec for_folder(Path.t()) :: {module(), Path.t()} | nil
  def for_folder(path) do
    Enum.find_value(of_folders(), fn reader ->
      resolved = reader.resolve(path)
      resolved && {reader, resolved}
    end)
  end

  @doc "The foreign recordings that lie in this very folder."
  @spec within(Path.t()) :: [Path.t()]
  def within(folder), do: Enum.flat_map(of_folders(), & &1.within(folder))

  defp of_folders,
    do: Enum.filter(all(), &(Code.ensure_loaded?(&1) and function_exported?(&1, :resolve, 1)))

  @doc "Every known reader of foreign files."
  @spec all() :: [module()]
  def all, do: Application.get_env(:situ_store, :readers, []) ++ brought() ++ @built_in

  defp brought do
    for {app, _, _} <- Application.loaded_applications(),
        reader <- Application.get_env(app, :store_readers, []),
        do: reader
  end
end
