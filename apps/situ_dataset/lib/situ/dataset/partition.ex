defmodule Situ.Dataset.Partition do
  @moduledoc """
  Represents one recording of a session: a store, or any file that a `Situ.Recording.Format` opens (WAV, CSV, video,
  MCAP, bags ...).

  A partition consists of a name and a path, and is opened only when needed. A dataset with a missing or damaged
  recording therefore still opens and can use the other recordings; `open/1` returns the error of this one.

      iex> partition = Situ.Dataset.Partition.new("Video", "/nowhere/lobby.0000")
      iex> {:error, error} = Situ.Dataset.Partition.open(partition)
      iex> error.code
      :no_store

  Fields: `name`, `store` (the recording's name), `path` (absolute), `reader` (the name of a reader module or of a
  reader of \\psi; `nil` to detect it from the file), `checksum` (from `Situ.Dataset.seal/2`, or `nil`), `metadata` (a
  JSON object), `extra` (unknown fields of the dataset file, which are kept).
  """
  alias Situ.{Error, Store}
  alias Situ.Dataset.{StoredPath, Summary}

  @enforce_keys [:name, :path]
  defstruct [:name, :store, :path, :reader, :checksum, metadata: %{}, extra: %{}]

  @type t :: %__MODULE__{
          name: String.t(),
          store: String.t() | nil,
          path: Path.t(),
          reader: String.t() | nil,
          checksum: String.t() | nil,
          metadata: map(),
          extra: map()
        }

  @doc """
  Builds a partition for the recording at `path`: the folder of a store, `ROOT/NAME` for its current newest version,
  an external file, or the address of a recording on another machine (`situ://lab1/lobby`). `name` may be `nil` to
  use the recording's name.

  Options: `reader:` (a module), `metadata:`.
  """
  @spec new(String.t() | nil, Path.t(), keyword()) :: t()
  def new(name, path, opts \\ []) do
    path = resolve_path(path)
    store = store_name(path)

    %__MODULE__{
      name: name || store,
      store: store,
      path: path,
      reader: opts[:reader] && inspect(opts[:reader]),
      metadata: opts[:metadata] || %{}
    }
  end

  defp resolve_path(path) do
    if StoredPath.address?(path) do
      path
    else
      path = Path.expand(path)
      Store.newest(Path.basename(path), Path.dirname(path)) |> choose_newest(path)
    end
  end

  # An existing folder is itself the store.
  defp choose_newest(nil, path), do: path
  defp choose_newest(newest, path), do: if(File.exists?(path), do: path, else: newest)

  defp store_name(path) do
    base = if StoredPath.address?(path), do: address_name(path), else: Path.basename(path)

    case Regex.run(~r/\A(.+)\.\d{4,}\z/, base) do
      [_, name] -> name
      nil -> if File.regular?(path), do: Path.rootname(base), else: base
    end
  end

  # The name follows the host. For a socket, whose path replaces the host, the name is in the query.
  defp address_name(address) do
    uri = URI.parse(address)

    case {uri.scheme, Path.basename(uri.path || "")} do
      {"situ+unix", _} -> URI.decode(uri.query || "recording")
      {_, ""} -> uri.host || "recording"
      {_, name} -> URI.decode(name)
    end
  end

  @doc "Opens the recording. Takes the options of `Situ.Store.open/2`."
  @spec open(t(), keyword()) :: {:ok, Store.t()} | {:error, Error.t()}
  def open(%__MODULE__{} = partition, opts \\ []) do
    with {:ok, path, reader} <- locate_recording(partition) do
      case Store.open(path, reader ++ opts) do
        {:ok, store} -> {:ok, store}
        {:error, error} -> {:error, wrap_error(partition, error)}
      end
    end
  end

  @doc "Returns time spans, sizes and counts; opens the recording."
  @spec summary(t()) :: {:ok, Summary.t()} | {:error, Error.t()}
  def summary(%__MODULE__{} = partition) do
    with {:ok, store} <- open(partition), do: {:ok, Summary.from_store(store)}
  end

  @doc """
  Checks that the recording can be opened, is complete and has not changed; returns `:ok` or the first problem.

  A recording with damage can be opened and read (`open/1`), but this check returns it as an error (`:damaged`).
  """
  @spec check_recording(t()) :: :ok | {:error, Error.t()}
  def check_recording(%__MODULE__{} = partition) do
    with {:ok, store} <- open(partition) do
      case {Store.missing_files(store), Store.info(store)[:damage] || []} do
        {[], []} ->
          :ok

        {[file | _], _} ->
          {:error, damaged_error(partition, "#{file} is missing")}

        {_, damage} ->
          {:error, damaged_error(partition, "it is damaged at #{length(damage)} positions")}
      end
    end
  end

  defp damaged_error(partition, why) do
    Error.new(:damaged, "partition #{inspect(partition.name)} is damaged",
      why: why,
      fix: "list the damage with `situ store verify`; `situ store repair` keeps the intact data",
      meta: %{path: partition.path}
    )
  end

  defp wrap_error(partition, error) do
    meta = Map.put(error.meta, :partition, partition.name)
    %{error | what: "partition #{inspect(partition.name)}: #{error.what}", meta: meta}
  end

  # Stores of \psi are files NAME.*_000000.psi in a folder that may contain several stores. Its JSON stores are
  # NAME.Catalog.json and NAME.Data.json.
  defp locate_recording(%{path: path, store: store, reader: reader} = partition) do
    cond do
      StoredPath.windows_path?(path) -> {:error, windows_path_error(partition)}
      File.dir?(path) and not Store.exists?(path) -> locate_in_folder(path, store, reader)
      true -> with {:ok, reader} <- resolve_reader(reader), do: {:ok, path, reader}
    end
  end

  defp windows_path_error(partition) do
    Error.new(
      :no_store,
      "partition #{inspect(partition.name)}: no recording at #{partition.path}",
      why: "the path is an absolute path of another operating system",
      fix: "copy the recording to the folder of the dataset file and use a relative path"
    )
  end

  defp locate_in_folder(path, store, reader) do
    candidates = ["#{store}.Catalog_000000.psi", "#{store}.Catalog.json"]

    case Enum.find(candidates, &File.regular?(Path.join(path, &1))) do
      nil -> with {:ok, reader} <- resolve_reader(reader), do: {:ok, path, reader}
      file -> {:ok, Path.join(path, file), []}
    end
  end

  # A name from a file must not create an atom, and may only name a reader module.
  defp resolve_reader(nil), do: {:ok, []}

  defp resolve_reader(name) do
    case Enum.find(Situ.Recording.Formats.list_formats(), &(inspect(&1) == name)) do
      nil when is_binary(name) ->
        if(psi_reader?(name), do: {:ok, []}, else: unknown_reader_error(name))

      module ->
        {:ok, [reader: module]}
    end
  end

  # For the .NET type names of \psi's readers, Situ detects its own reader from the file.
  defp psi_reader?(name), do: name =~ ~r/StreamReader\b/ or name =~ ~r/, /

  defp unknown_reader_error(name) do
    known = Enum.map_join(Situ.Recording.Formats.list_formats(), ", ", &inspect/1)

    {:error,
     Error.new(:unknown_reader, "unknown reader #{inspect(name)}",
       why: "the available readers are #{known}",
       fix:
         "load the application that provides it, or remove the reader to detect it from the file"
     )}
  end
end
