defmodule Situ.Dataset.Document do
  @moduledoc """
  The dataset file: JSON that people may edit (schema: `priv/schema/dataset.schema.json`).

      {"version": 1, "name": "Study", "tags": [], "metadata": {},
       "sessions": [
         {"name": "p01", "tags": ["pilot"], "metadata": {"participant": "P01"},
          "partitions": [{"name": "Room", "store": "room", "path": "p01/room.0000"}]}]}

  Paths are relative to the file and use forward slashes. Saving keeps unknown fields of the file. \\psi's `.pds`
  files, which have the same structure with other names, are read but never written.
  """
  alias Situ.Dataset.{DatasetFile, Names, Partition, Session, StoredPath}
  alias Situ.Error

  @version 1
  @largest 64 * 1024 * 1024

  @type dataset :: %{
          name: String.t(),
          metadata: map(),
          tags: [String.t()],
          sessions: [Session.t()],
          extra: map()
        }

  @doc "Reads a dataset file."
  @spec read(Path.t()) :: {:ok, dataset()} | {:error, Error.t()}
  def read(path) do
    with {:ok, dataset, _digest} <- read_digested(path), do: {:ok, dataset}
  end

  @doc "Reads a dataset file and returns `{:ok, dataset, digest}` with the digest of its text."
  @spec read_digested(Path.t()) :: {:ok, dataset(), String.t()} | {:error, Error.t()}
  def read_digested(path) do
    with {:ok, text} <- text(path) do
      case parse(text, path) do
        {:ok, dataset} -> {:ok, dataset, DatasetFile.digest(text)}
        {:error, why} -> {:error, refused(path, why)}
      end
    end
  end

  @doc "Returns whether a file is probably a dataset; reads only its first bytes."
  @spec dataset?(Path.t()) :: boolean()
  def dataset?(path) do
    File.regular?(path) and (Path.extname(path) == ".pds" or json?(path))
  end

  defp json?(path) do
    with ".json" <- Path.extname(path),
         {:ok, device} <- File.open(path, [:read, :binary]) do
      head = IO.binread(device, 65_536)
      _ = File.close(device)
      is_binary(head) and head =~ ~r/\A\s*\{/ and head =~ ~r/"[Ss]essions"\s*:/
    else
      _ -> false
    end
  end

  defp text(path) do
    with {:ok, %{type: :regular, size: size}} when size <= @largest <- File.stat(path),
         {:ok, text} <- File.read(path) do
      {:ok, text}
    else
      {:ok, %{type: :regular, size: size}} ->
        {:error, refused(path, "it has #{size} bytes; a dataset file has at most #{@largest}")}

      {:ok, %{type: type}} ->
        {:error, refused(path, "it is a #{type}")}

      {:error, reason} ->
        {:error,
         Error.new(:not_found, "cannot read the dataset #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "check the path"
         )}
    end
  end

  defp refused(path, why) do
    Error.new(:bad_dataset, "#{path} is not a dataset file",
      why: why,
      fix:
        "see `Situ.Dataset.Document` for the format, or create a dataset with `situ dataset create`"
    )
  end

  @doc "Parses the text of the dataset file `path`; returns `{:ok, dataset}`, or the reason in words."
  @spec parse(binary(), Path.t()) :: {:ok, dataset()} | {:error, String.t()}
  def parse(text, path) do
    case Situ.JSON.decode(text) do
      {:ok, %{"sessions" => _} = json} -> ours(json, path)
      {:ok, %{"Sessions" => _} = json} -> psi(json, path)
      {:ok, _} -> {:error, "it does not have \"sessions\""}
      {:error, :bad_json} -> {:error, "it is not JSON"}
    end
  catch
    {:refused, why} -> {:error, why}
  end

  defp ours(json, path) do
    if json["version"] not in [nil, @version],
      do:
        refuse(
          "its version is #{inspect(json["version"])}; this release of Situ reads version #{@version}"
        )

    {:ok, dataset(json, &ours_partition(&1, path), "sessions", "partitions", "name")}
  end

  # The file was written on Windows, so its paths may contain backslashes.
  defp psi(json, path) do
    {:ok, dataset(json, &psi_partition(&1, path), "Sessions", "Partitions", "Name")}
  end

  defp dataset(json, partition, sessions, partitions, name) do
    all = json |> Map.fetch!(sessions) |> objects(sessions)

    %{
      name: string(json, name, "the dataset", "Untitled Dataset"),
      metadata: object(json, "metadata", "the dataset"),
      tags: strings(json, "tags", "the dataset"),
      sessions: Enum.map(all, &session(&1, partition, partitions, name)) |> unique("session"),
      extra: Map.drop(json, ["version", name, "metadata", "tags", sessions])
    }
  end

  defp session(json, partition, partitions, key) do
    name = name(json, key, "session")
    place = "session #{inspect(name)}"
    all = json |> Map.get(partitions, []) |> objects("#{partitions} of #{place}")

    %Session{
      name: name,
      metadata: object(json, "metadata", place),
      tags: strings(json, "tags", place),
      partitions: all |> Enum.map(partition) |> unique("partition of #{place}"),
      extra: Map.drop(json, [key, "metadata", "tags", partitions])
    }
  end

  defp ours_partition(json, file) do
    name = name(json, "name", "partition")
    place = "partition #{inspect(name)}"

    %Partition{
      name: name,
      store: optional(json, "store", place),
      path: json |> required("path", place) |> StoredPath.from_stored(file),
      reader: optional(json, "reader", place),
      checksum: optional(json, "checksum", place),
      metadata: object(json, "metadata", place),
      extra: Map.drop(json, ~w(name store path reader checksum metadata))
    }
  end

  defp psi_partition(json, file) do
    name = name(json, "Name", "partition")
    place = "partition #{inspect(name)}"
    stored = required(json, "StorePath", place)

    stored =
      if StoredPath.windows?(stored) or StoredPath.windows?(file),
        do: stored,
        else: StoredPath.portable(stored)

    path =
      if StoredPath.windows?(stored),
        do: stored,
        else: StoredPath.from_stored(stored, file)

    %Partition{
      name: name,
      store: optional(json, "StoreName", place),
      path: path,
      reader: optional(json, "StreamReaderTypeName", place),
      extra: %{}
    }
  end

  defp unique(items, kind) do
    names = Enum.map(items, & &1.name)

    case names -- Enum.uniq(names) do
      [] -> items
      [twice | _] -> refuse("it contains the #{kind} #{inspect(twice)} twice")
    end
  end

  defp name(json, key, kind) do
    name = json[key]

    case Names.check(name, kind) do
      :ok -> name
      {:error, error} -> refuse(error.what)
    end
  end

  defp objects(list, place) do
    if is_list(list) and Enum.all?(list, &is_map/1),
      do: list,
      else: refuse("#{place} must be a list of objects")
  end

  defp object(json, key, place) do
    case json[key] do
      nil -> %{}
      %{} = map -> map
      _ -> refuse("#{key} of #{place} is not an object")
    end
  end

  defp strings(json, key, place) do
    list = json[key] || []

    if is_list(list) and Enum.all?(list, &is_binary/1),
      do: list,
      else: refuse("#{key} of #{place} must be a list of strings")
  end

  defp string(json, key, place, default), do: optional(json, key, place) || default

  defp required(json, key, place),
    do: optional(json, key, place) || refuse("#{place} has no #{key}")

  defp optional(json, key, place) do
    case json[key] do
      nil -> nil
      text when is_binary(text) -> text
      _ -> refuse("#{key} of #{place} is not a string")
    end
  end

  @spec refuse(String.t()) :: no_return()
  defp refuse(why), do: throw({:refused, why})

  @doc "Encodes a dataset as the text of a file that will be saved as `path`."
  @spec render(dataset() | map(), Path.t()) :: String.t()
  def render(dataset, path) do
    members = [
      {"version", @version},
      {"name", dataset.name},
      {"tags", dataset.tags},
      {"metadata", dataset.metadata}
    ]

    sessions = {"sessions", Enum.map(dataset.sessions, &session_members(&1, path))}
    text = pretty({:object, members ++ Enum.sort(dataset.extra) ++ [sessions]}, "")
    IO.iodata_to_binary([text, "\n"])
  end

  defp session_members(session, path) do
    partitions = {"partitions", Enum.map(session.partitions, &partition_members(&1, path))}
    head = [{"name", session.name}, {"tags", session.tags}, {"metadata", session.metadata}]
    {:object, Enum.reject(head, &blank?/1) ++ Enum.sort(session.extra) ++ [partitions]}
  end

  defp partition_members(partition, path) do
    stored =
      if StoredPath.windows?(partition.path),
        do: partition.path,
        else: StoredPath.to_stored(partition.path, path)

    members = [
      {"name", partition.name},
      {"store", partition.store},
      {"path", stored},
      {"reader", partition.reader},
      {"checksum", partition.checksum},
      {"metadata", partition.metadata}
    ]

    {:object, Enum.reject(members, &blank?/1) ++ Enum.sort(partition.extra)}
  end

  defp blank?({_, value}), do: value in [nil, [], %{}]

  # Writes members in a readable order; the JSON encoder does not define one.
  defp pretty({:object, members}, indent), do: lines("{", members, "}", indent)
  defp pretty([{:object, _} | _] = list, indent), do: lines("[", list, "]", indent)
  defp pretty(value, _indent), do: Situ.JSON.encode(value)

  defp lines(open, items, close, indent) do
    inner = indent <> "  "
    items = Enum.map_intersperse(items, [",\n", inner], &item(&1, inner))
    [open, "\n", inner, items, "\n", indent, close]
  end

  defp item({key, value}, indent) when is_binary(key),
    do: [Situ.JSON.encode(key), ": ", pretty(value, indent)]

  defp item(value, indent), do: pretty(value, indent)
end
