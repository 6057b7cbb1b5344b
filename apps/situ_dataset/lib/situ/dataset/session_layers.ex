defmodule Situ.Dataset.SessionLayers do
  @moduledoc """
  Manages the annotation layers of a session. A layer is an annotation stream, such as the tiers of one annotator.

      iex> alias Situ.Annotation.{Layer, Schema}
      iex> alias Situ.Dataset.{OpenSession, SessionLayers}
      iex> folder = Path.join(System.tmp_dir!(), "situ-doc-layers")
      iex> {:ok, dataset} = Situ.Dataset.new("Study", file: Path.join(folder, "study.json"), autosave: true)
      iex> {:ok, dataset} = Situ.Dataset.add_session(dataset, "p01")
      iex> {:ok, empty} = Layer.new(Schema.finite("Speech", ["speaks"]))
      iex> {:ok, dataset} = SessionLayers.create_layer(dataset, "p01", "Speech.Ada", empty)
      iex> {:ok, session} = Situ.Dataset.session(dataset, "p01")
      iex> session |> OpenSession.open() |> SessionLayers.list_layers()
      [%{partition: "Annotations", stream: "Speech.Ada", editable?: true}]
      iex> {:ok, path} = SessionLayers.store_path(dataset, "p01")
      iex> Path.relative_to(path, folder)
      "p01/annotations"
      iex> File.rm_rf!(folder) != []
      true

  The layers of a session are the streams of one store, `SESSION/annotations` next to the dataset file. The session
  contains this store as a partition. Its path has no version, so the partition is always the newest version. Edit a
  layer with `Situ.Annotation.Editor`: its `path:` is `store_path/2` and its `stream:` is the name of the layer.

  Layers in other partitions are listed, too, such as layers of \\psi or of a batch task. They are not modified, but
  `copy_layer/4` copies one into an editable layer. Dataset files in one folder share the layers of sessions with the
  same name.
  """
  # See docs/adr/0169-the-layers-of-a-session-are-one-store.md.
  alias Situ.Annotation.{Layer, LayerHistory, Recording}
  alias Situ.{Dataset, Error}
  alias Situ.Dataset.{LayersPartition, NameRules, OpenSession, Partition, Session}

  @type layer_info :: %{partition: String.t(), stream: String.t(), editable?: boolean()}

  @doc """
  Returns the path of the store of the session's editable layers, without a version. The store may not exist yet.
  Errors: `:no_session`, and `:no_file` if the dataset does not have a file, such as a dataset of \\psi.
  """
  @spec store_path(Dataset.t(), String.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def store_path(%Dataset{} = dataset, name) do
    with {:ok, session} <- Dataset.session(dataset, name) do
      case Enum.find(session.partitions, &layers_partition?/1) do
        nil -> new_store_path(dataset, name)
        partition -> {:ok, partition.path}
      end
    end
  end

  defp new_store_path(%Dataset{file: nil}, _name) do
    {:error,
     Error.new(:no_file, "the session cannot have annotation layers",
       why: "its dataset does not have a file that can be changed",
       fix: "save a copy of the dataset as a .json file and annotate the copy"
     )}
  end

  defp new_store_path(%Dataset{file: file}, name),
    do:
      {:ok,
       file |> Path.dirname() |> Path.join(escape_name(name)) |> LayersPartition.store_path()}

  # A session may have the name of a recording that is next to the dataset file. The name of a recording's folder
  # contains a dot, which is escaped here, so that nothing is written into the recording.
  defp escape_name(name),
    do: name |> URI.encode(&URI.char_unreserved?/1) |> String.replace(".", "%2E")

  @doc "Returns whether the partition is the store of a session's editable layers."
  @spec layers_partition?(Partition.t()) :: boolean()
  def layers_partition?(%Partition{path: path}), do: LayersPartition.layers_path?(path)

  @doc "Lists the annotation streams of all partitions. They are recognised by their type or their schema."
  @spec list_layers(OpenSession.t()) :: [layer_info()]
  def list_layers(%OpenSession{} = open) do
    own = for p <- open.session.partitions, layers_partition?(p), do: p.name

    for {partition, info} <- OpenSession.list_streams(open),
        {:ok, store} = OpenSession.fetch_store(open, partition),
        Recording.annotation_stream?(store, info),
        do: %{partition: partition, stream: info.name, editable?: partition in own}
  end

  @doc """
  Creates a layer with these annotations and adds the store to the session if it is the first layer. Several programs
  may create layers of a session at the same time. Errors: `:layer_exists`, the errors of `store_path/2`, and the
  errors of `Situ.Dataset.update/2`.
  """
  @spec create_layer(Dataset.t(), String.t(), String.t(), Layer.t()) :: Dataset.result()
  def create_layer(%Dataset{} = dataset, session, name, %Layer{} = layer) do
    with {:ok, path} <- store_path(dataset, session),
         :ok <- write_layer(path, name, layer),
         do: Dataset.update(dataset, &add_partition(&1, session))
  end

  @doc """
  Writes a new layer into the store at `path`. Use it with `add_partition/2` if another process edits the dataset.
  Error: `:layer_exists`.
  """
  @spec write_layer(Path.t(), String.t(), Layer.t()) :: :ok | {:error, Error.t()}
  def write_layer(path, name, %Layer{} = layer) do
    with :ok <- NameRules.check_valid(name, "layer"),
         do: LayerHistory.create_layer(path, name, layer)
  end

  @doc """
  Adds the store of the editable layers to the session as a partition, unless the session already has it. Does not
  access the store.
  """
  @spec add_partition(Dataset.t(), String.t()) :: Dataset.result()
  def add_partition(%Dataset{} = dataset, name) do
    with {:ok, path} <- store_path(dataset, name) do
      Dataset.update_session(dataset, name, fn session ->
        if Enum.any?(session.partitions, &layers_partition?/1),
          do: {:ok, session},
          else: Session.add_partition(session, named_partition(session, path))
      end)
    end
  end

  defp named_partition(session, path) do
    partition = LayersPartition.build_partition(path)
    names = Enum.map(session.partitions, & &1.name)
    %{partition | name: NameRules.make_unique(partition.name, names)}
  end

  @doc """
  Copies a layer of any partition into an editable layer named `name`. `address` is the stream's name or
  `"[Partition]:Stream"`. Errors: `:layer_exists` and the errors of `Situ.Dataset.OpenSession.fetch_stream/2`.
  """
  @spec copy_layer(Dataset.t(), String.t(), String.t(), String.t()) :: Dataset.result()
  def copy_layer(%Dataset{} = dataset, session, address, name) do
    with {:ok, found} <- Dataset.session(dataset, session),
         {:ok, {_, store, stream}} <- OpenSession.fetch_stream(OpenSession.open(found), address),
         {:ok, layer} <- Recording.load_layer(store, stream),
         do: create_layer(dataset, session, name, layer)
  end
end
