defmodule Situ.Dataset.Partition do
  @moduledoc """
  One recording of a session: a store, or any file that a `Situ.Store.Reader` opens (WAV, CSV, films, MCAP, bags
  ...).

  A partition is a name and a place; nothing is opened until it is asked for, so that a dataset with a missing or
  damaged recording still opens, lists the others, and says of this one what is wrong (`open/1`).

      iex> partition = Situ.Dataset.Partition.new("Video", "/nowhere/lobby.0000")
      iex> {:error, error} = Situ.Dataset.Partition.open(partition)
      iex> error.code
      :no_store

  Fields: `name`, `store` (the recording's own name), `path` (absolute), `reader` (the name of a reader's module or
  of a reader of \\psi, or `nil` to go by the file), `checksum` (`Situ.Dataset.Checksum`, or `nil`), `metadata` (a
  JSON object), `extra` (what else the dataset file says of it; kept).
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
  A partition for the recording at `path`: a store's folder, `ROOT/NAME` for its newest version now, a foreign
  file, or the address of a recording on another machine (`situ://lab1/lobby`). `name` may be `nil`: then it is the recording's.

  Options: `reader:` (a module), `metadata:`.
  """
  @spec new(String.t() | nil, Path.t(), keyword()) :: t()
  def new(name, path, opts \\ []) do
    path = located(path)
    store = store_name(path)

    %__MODULE__{
      name: name || store,
      store: store,
      path: path,
      reader: opts[:reader] && inspect(opts[:reader]),
      metadata: opts[:metadata] || %{}
    }
  end

  defp located(path) do
    if StoredPath.address?(path) do
      path
    else
      path = Path.expand(path)
      Store.newest(Path.basename(path), Path.dirname(path)) |> newest(path)
    end
  end

  # The folder named, when it is a store itself.
  defp newest(nil, path), do: path
  defp newest(newest, path), do: if(File.exists?(path), do: path, else: newest)

  defp store_name(path) do
    base = if StoredPath.address?(path), do: name_in(path), else: Path.basename(path)

    case Regex.run(~r/\A(.+)\.\d{4,}\z/, base) do
      [_, name] -> name
      nil -> if File.regular?(path), do: Path.rootname(base), else: base
    end
  end

  # The name after the host; in the query for a socket, whose path takes the place of the host.
  defp name_in(address) do
    uri = URI.parse(address)

    case {uri.scheme, Path.basename(uri.path || "")} do
      {"situ+unix", _} -> URI.decode(uri.query || "recording")
      {_, ""} -> uri.host || "recording"
      {_, name} -> URI.decode(name)
    end
  end

  @doc "Opens the recording. Options as `Situ.Store.open/2`."
  @spec open(t(), keyword()) :: {:ok, Store.t()} | {:error, Error.t()}
  def open(%__MODULE__{} = partition, opts \\ []) do
    with {:ok, path, reader} <- place(partition) do
      case Store.open(path, reader ++ opts) do
        {:ok, store} -> {:ok, store}
        {:error, error} -> {:error, about(partition, error)}
      end
    end
  end

  @doc "Spans, sizes and counts; opens the recording."
  @spec summary(t()) :: {:ok, Summary.t()} | {:error, Error.t()}
  def summary(%__MODULE__{} = partition) do
    with {:ok, store} <- open(partition), do: {:ok, Summary.of(store)}
  end

  @doc """
  Whether the recording can be opened, is whole and is what it was: `:ok`, or the first thing wrong with it.

  A recording with damage opens and is read (`open/1`); here it counts as an error (`:damaged`).
  """
  @spec check(t()) :: :ok | {:error, Error.t()}
  def check(%__MODULE__{} = partition) do
    with {:ok, store} <- open(partition) do
      case {Store.missing_files(store), Store.info(store)[:damage] || []} do
        {[], []} -> :ok
        {[file | _], _} -> {:error, damaged(partition, "#{file} is missing")}
        {_, damage} -> {:error, damaged(partition, "it has #{length(damage)} damaged places")}
      end
    end
  end

  defp damaged(partition, why) do
    Error.new(:damaged, "partition #{inspect(partition.name)} is damaged",
      why: why,
      fix: "`situ store verify` lists the damage, `situ store repair` keeps what is sound",
      meta: %{path: partition.path}
    )
  end

  defp about(partition, error) do
    meta = Map.put(error.meta, :partition, partition.name)
    %{error | what: "partition #{inspect(partition.name)}: #{error.what}", meta: meta}
  end

  # Stores of \psi are files NAME.*_000000.psi in a folder that may hold several; its JSON stores are
  # NAME.Catalog.json and NAME.Data.json.
  defp place(%{path: path, store: store, reader: reader} = partition) do
    cond do
      StoredPath.windows?(path) -> {:error, foreign(partition)}
      File.dir?(path) and not Store.exists?(path) -> in_folder(path, store, reader)
      true -> with {:ok, reader} <- reader(reader), do: {:ok, path, reader}
    end
  end

  defp foreign(partition) do
    Error.new(
      :no_store,
      "partition #{inspect(partition.name)}: no recording at #{partition.path}",
      why: "the path is absolute and of another system",
      fix: "put the recording beside the dataset file and name it with a relative path"
    )
  end

  defp in_folder(path, store, reader) do
    candidates = ["#{store}.Catalog_000000.psi", "#{store}.Catalog.json"]

    case Enum.find(candidates, &File.regular?(Path.join(path, &1))) do
      nil -> with {:ok, reader} <- reader(reader), do: {:ok, path, reader}
      file -> {:ok, Path.join(path, file), []}
    end
  end

  # A name out of a file makes no atom and names no module but a reader.
  defp reader(nil), do: {:ok, []}

  defp reader(name) do
    case Enum.find(Store.Formats.all(), &(inspect(&1) == name)) do
      nil when is_binary(name) -> if(foreign_reader?(name), do: {:ok, []}, else: unknown(name))
      module -> {:ok, [reader: module]}
    end
  end

  # The .NET type names of \psi's readers: the file tells which reader of ours it is.
  defp foreign_reader?(name), do: name =~ ~r/StreamReader\b/ or name =~ ~r/, /

  defp unknown(name) do
    known = Enum.map_join(Store.Formats.all(), ", ", &inspect/1)

    {:error,
     Error.new(:unknown_reader, "there is no reader #{inspect(name)}",
       why: "readers here: #{known}",
       fix: "load the application that brings it, or take the reader out to go by the file"
     )}
  end
end
