defmodule Situ.CLI.Annotate.Source do
  @moduledoc false
  # Opens the annotations that `situ annotate` works on: a recording with annotations, or a session of a dataset file,
  # whose layers may be in any of its partitions.
  alias Situ.Annotation.{Layer, LayerDocument, Recording, StoreVersions}
  alias Situ.CLI.Option
  alias Situ.{Dataset, Error, Store}
  alias Situ.Dataset.{FileFormat, OpenSession, Session, SessionLayers}

  @typedoc "A recording, or an open session."
  @type t :: {:recording, Store.t()} | {:session, OpenSession.t()}

  @doc "Returns the option that names a session."
  @spec session_option() :: Option.t()
  def session_option,
    do:
      Option.new(
        :session,
        :string,
        "the session, if PATH is a dataset file (default: the only one)",
        value: "NAME"
      )

  @doc "Returns whether the path is a dataset file."
  @spec dataset?(Path.t()) :: boolean()
  def dataset?(path), do: FileFormat.dataset_file?(path)

  @doc "Opens the sources at a path: a recording, one session, or all sessions of a dataset with their names."
  @spec open_all!(Path.t(), String.t() | nil) :: [{name :: String.t() | nil, t()}]
  def open_all!(path, session) do
    cond do
      session != nil -> [{session, open!(path, session)}]
      dataset?(path) -> for s <- open_dataset!(path).sessions, do: {s.name, open_session(s)}
      true -> [{nil, open!(path, nil)}]
    end
  end

  @doc "Opens a recording, or a session of a dataset. Raises an error that lists the sessions if one must be chosen."
  @spec open!(Path.t(), String.t() | nil) :: t()
  def open!(path, session) do
    if session != nil or dataset?(path),
      do: path |> open_dataset!() |> choose_session!(session) |> open_session(),
      else: {:recording, Situ.CLI.Recording.open!(path)}
  end

  @doc "Opens the dataset file at a path."
  @spec open_dataset!(Path.t()) :: Dataset.t()
  def open_dataset!(path), do: Situ.CLI.Dataset.open_dataset!(path)

  @doc "Returns the named session, or the dataset's only one."
  @spec choose_session!(Dataset.t(), String.t() | nil) :: Session.t()
  def choose_session!(%{sessions: [one]}, nil), do: one

  def choose_session!(%{sessions: sessions, name: name}, nil) do
    names = sessions |> Enum.take(8) |> Enum.map_join(", ", & &1.name)

    raise Error.new(
            :ambiguous_session,
            "dataset #{inspect(name)} has #{length(sessions)} sessions",
            fix: "choose one with --session: #{names}"
          )
  end

  def choose_session!(dataset, name), do: Error.unwrap!(Dataset.session(dataset, name))

  defp open_session(session), do: {:session, OpenSession.open(session)}

  @doc "Returns the names of the annotation streams."
  @spec list_streams(t()) :: [String.t()]
  def list_streams({:recording, store}) do
    for info <- Store.streams(store), Recording.annotation_stream?(store, info), do: info.name
  end

  def list_streams({:session, open}) do
    for %{partition: partition, stream: stream} <- SessionLayers.list_layers(open),
        do: OpenSession.shortest_address(open, partition, stream)
  end

  @doc "Returns the annotations of a stream; `nil` means the only annotation stream."
  @spec load_layer!(t(), String.t() | nil) :: Layer.t()
  def load_layer!(source, nil), do: load_layer!(source, only_stream!(source))

  def load_layer!({:recording, store}, name), do: load_current!(store, name)

  def load_layer!({:session, open}, name) do
    {_, store, stream} = Error.unwrap!(OpenSession.fetch_stream(open, name))
    load_current!(store, stream)
  end

  # The newest version includes the edits in its log that no version contains yet.
  defp load_current!(store, stream) do
    path = String.replace(store.path, ~r/\.\d{4,}\/*$/, "")
    log = LayerDocument.document_path(path, stream) <> ".edits"

    if File.exists?(log) and StoreVersions.newest_folder(path) == store.path,
      do: Error.unwrap!(LayerDocument.open(path, stream, nil)).layer,
      else: Error.unwrap!(Recording.load_layer(store, stream))
  end

  defp only_stream!(source) do
    case list_streams(source) do
      [one] ->
        one

      [] ->
        raise Error.new(:no_stream, "#{describe(source)} has no annotation stream",
                fix: "run `situ store info` to list its streams"
              )

      several ->
        raise Error.new(
                :ambiguous_stream,
                "#{describe(source)} has #{length(several)} annotation streams",
                fix: "choose one with --stream: #{Enum.join(several, ", ")}"
              )
    end
  end

  @doc "Describes the source for messages."
  @spec describe(t()) :: String.t()
  def describe({:recording, store}), do: store.path
  def describe({:session, open}), do: "session #{open.session.name}"

  @doc """
  Returns the start of the annotated recordings, which is time 0 of an exported file, or `nil` for a recording that has
  only annotations.
  """
  @spec start_time(t()) :: Situ.Time.t() | nil
  def start_time({:recording, store}) do
    starts =
      for info <- Store.streams(store),
          info.count > 0,
          not Recording.annotation_stream?(store, info),
          do: info.first

    Enum.min(starts, fn -> nil end)
  end

  def start_time({:session, open}) do
    layers = for p <- open.session.partitions, SessionLayers.layers_partition?(p), do: p.name

    open.stores
    |> Enum.reject(fn {name, _} -> name in layers end)
    |> Enum.flat_map(fn {_, store} -> store |> Store.interval() |> List.wrap() end)
    |> Enum.map(&elem(&1, 0))
    |> Enum.min(fn -> nil end)
  end

  @doc "Returns the time of a recording's first message, or raises the error."
  @spec first_time!(Path.t()) :: Situ.Time.t()
  def first_time!(path) do
    case path |> Situ.CLI.Recording.open!() |> Store.interval() do
      {first, _} -> first
      nil -> raise Error.new(:empty, "#{path} has no messages", fix: "give --origin")
    end
  end

  @doc "Returns the options that choose a layer that can be edited."
  @spec layer_options() :: [Option.t()]
  def layer_options do
    [
      Option.new(:stream, :string, "the layer (default: the only one)", short: :s, value: "NAME"),
      session_option()
    ]
  end

  @doc "Returns the store (without a version) and the stream of a layer that can be edited, or raises an error."
  @spec find_layer!(Path.t(), keyword()) :: {Path.t(), String.t()}
  def find_layer!(path, opts) do
    if dataset?(path) do
      dataset = open_dataset!(path)
      session = choose_session!(dataset, opts[:session])
      layers = session |> OpenSession.open() |> SessionLayers.list_layers()
      names = for %{editable?: true, stream: stream} <- layers, do: stream

      {Error.unwrap!(SessionLayers.store_path(dataset, session.name)),
       choose_stream!(names, opts[:stream])}
    else
      names = path |> open!(nil) |> list_streams()
      {String.replace(path, ~r/\.\d{4,}\/*$/, ""), choose_stream!(names, opts[:stream])}
    end
  end

  defp choose_stream!([one], nil), do: one

  defp choose_stream!([], _stream) do
    raise Error.new(:no_layer, "the recording has no annotations that can be edited",
            fix: "create one in the studio or with `situ annotate import`"
          )
  end

  defp choose_stream!(names, nil) do
    raise Error.new(:ambiguous_stream, "there are #{length(names)} layers",
            fix: "choose one with --stream: #{Enum.join(names, ", ")}"
          )
  end

  defp choose_stream!(names, name) do
    if name in names,
      do: name,
      else:
        raise(
          Error.new(:no_layer, "layer #{inspect(name)} does not exist",
            fix: "choose from: #{Enum.join(names, ", ")}"
          )
        )
  end
end
