defmodule Situ.Dataset.FileFormat do
  @moduledoc false
  # Reads and writes dataset files, whose form `Situ.Dataset` describes. \psi's `.pds` files, which
  # have the same structure with other names, are read but never written.
  alias Situ.Dataset.{NameRules, Partition, Session, StoredPath}

  @version 1

  @type dataset :: %{
          name: String.t(),
          metadata: map(),
          tags: [String.t()],
          sessions: [Session.t()],
          extra: map()
        }

  @doc "Returns whether a file is probably a dataset; reads only its first bytes."
  @spec dataset_file?(Path.t()) :: boolean()
  def dataset_file?(path) do
    File.regular?(path) and (Path.extname(path) == ".pds" or json_dataset?(path))
  end

  defp json_dataset?(path) do
    with ".json" <- Path.extname(path),
         {:ok, device} <- File.open(path, [:read, :binary]) do
      head = IO.binread(device, 65_536)
      _ = File.close(device)
      is_binary(head) and head =~ ~r/\A\s*\{/ and head =~ ~r/"[Ss]essions"\s*:/
    else
      _ -> false
    end
  end

  @doc "Parses the text of the dataset file `path`; returns `{:ok, dataset}`, or the reason in words."
  @spec parse(binary(), Path.t()) :: {:ok, dataset()} | {:error, String.t()}
  def parse(text, path) do
    case Situ.JSON.decode(text) do
      {:ok, %{"sessions" => _} = json} -> parse_native(json, path)
      {:ok, %{"Sessions" => _} = json} -> parse_psi(json, path)
      {:ok, _} -> {:error, "it does not have \"sessions\""}
      {:error, :bad_json} -> {:error, "it is not JSON"}
    end
  catch
    {:refused, why} -> {:error, why}
  end

  defp parse_native(json, path) do
    if json["version"] not in [nil, @version],
      do:
        reject_file(
          "its version is #{inspect(json["version"])}; this release of Situ reads version #{@version}"
        )

    {:ok, build_dataset(json, &native_partition(&1, path), "sessions", "partitions", "name")}
  end

  # The file was written on Windows, so its paths may contain backslashes.
  defp parse_psi(json, path) do
    {:ok, build_dataset(json, &psi_partition(&1, path), "Sessions", "Partitions", "Name")}
  end

  defp build_dataset(json, partition, sessions, partitions, name) do
    all = json |> Map.fetch!(sessions) |> check_objects(sessions)

    %{
      name: get_string(json, name, "the dataset", "Untitled Dataset"),
      metadata: get_object(json, "metadata", "the dataset"),
      tags: get_strings(json, "tags", "the dataset"),
      sessions:
        Enum.map(all, &build_session(&1, partition, partitions, name))
        |> require_unique("session"),
      extra: Map.drop(json, ["version", name, "metadata", "tags", sessions])
    }
  end

  defp build_session(json, partition, partitions, key) do
    name = fetch_name(json, key, "session")
    owner = "session #{inspect(name)}"
    all = json |> Map.get(partitions, []) |> check_objects("#{partitions} of #{owner}")

    %Session{
      name: name,
      metadata: get_object(json, "metadata", owner),
      tags: get_strings(json, "tags", owner),
      partitions: all |> Enum.map(partition) |> require_unique("partition of #{owner}"),
      extra: Map.drop(json, [key, "metadata", "tags", partitions])
    }
  end

  defp native_partition(json, file) do
    name = fetch_name(json, "name", "partition")
    owner = "partition #{inspect(name)}"

    %Partition{
      name: name,
      store: optional_string(json, "store", owner),
      path: json |> require_string("path", owner) |> StoredPath.from_stored(file),
      reader: optional_string(json, "reader", owner),
      checksum: optional_string(json, "checksum", owner),
      metadata: get_object(json, "metadata", owner),
      extra: Map.drop(json, ~w(name store path reader checksum metadata))
    }
  end

  defp psi_partition(json, file) do
    name = fetch_name(json, "Name", "partition")
    owner = "partition #{inspect(name)}"
    stored = require_string(json, "StorePath", owner)

    stored =
      if StoredPath.windows_path?(stored) or StoredPath.windows_path?(file),
        do: stored,
        else: StoredPath.to_portable(stored)

    path =
      if StoredPath.windows_path?(stored),
        do: stored,
        else: StoredPath.from_stored(stored, file)

    %Partition{
      name: name,
      store: optional_string(json, "StoreName", owner),
      path: path,
      reader: optional_string(json, "StreamReaderTypeName", owner),
      extra: %{}
    }
  end

  defp require_unique(items, kind) do
    names = Enum.map(items, & &1.name)

    case names -- Enum.uniq(names) do
      [] -> items
      [twice | _] -> reject_file("it contains the #{kind} #{inspect(twice)} twice")
    end
  end

  defp fetch_name(json, key, kind) do
    name = json[key]

    case NameRules.check_valid(name, kind) do
      :ok -> name
      {:error, error} -> reject_file(error.what)
    end
  end

  defp check_objects(list, owner) do
    if is_list(list) and Enum.all?(list, &is_map/1),
      do: list,
      else: reject_file("#{owner} must be a list of objects")
  end

  defp get_object(json, key, owner) do
    case json[key] do
      nil -> %{}
      %{} = map -> map
      _ -> reject_file("#{key} of #{owner} is not an object")
    end
  end

  defp get_strings(json, key, owner) do
    list = json[key] || []

    if is_list(list) and Enum.all?(list, &is_binary/1),
      do: list,
      else: reject_file("#{key} of #{owner} must be a list of strings")
  end

  defp get_string(json, key, owner, default), do: optional_string(json, key, owner) || default

  defp require_string(json, key, owner),
    do: optional_string(json, key, owner) || reject_file("#{owner} has no #{key}")

  defp optional_string(json, key, owner) do
    case json[key] do
      nil -> nil
      text when is_binary(text) -> text
      _ -> reject_file("#{key} of #{owner} is not a string")
    end
  end

  @spec reject_file(String.t()) :: no_return()
  defp reject_file(why), do: throw({:refused, why})

  @doc "Parses a session from the JSON that `session_json/2` returned."
  @spec parse_session(term(), Path.t()) :: {:ok, Session.t()} | {:error, String.t()}
  def parse_session(%{} = json, path) do
    {:ok, build_session(json, &native_partition(&1, path), "partitions", "name")}
  catch
    {:refused, why} -> {:error, why}
  end

  def parse_session(_json, _path), do: {:error, "it is not a session"}

  @doc """
  Converts a session to JSON with all of its lists and objects, also empty ones, as in a file that is saved as `path`.
  """
  @spec session_json(Session.t(), Path.t()) :: map()
  def session_json(session, path) do
    {:ok, json} =
      session
      |> encode_session(path)
      |> encode_pretty("")
      |> IO.iodata_to_binary()
      |> Situ.JSON.decode()

    partitions = for p <- json["partitions"], do: Map.merge(%{"metadata" => %{}}, p)
    Map.merge(%{"tags" => [], "metadata" => %{}}, %{json | "partitions" => partitions})
  end

  @doc """
  Encodes a dataset as the text of a file that will be saved as `path`. `mark` is the text of the member `edits`
  (`Situ.EditLog.Mark`), or `nil`.
  """
  @spec encode(dataset() | map(), Path.t(), String.t() | nil) :: String.t()
  def encode(dataset, path, mark \\ nil) do
    members = [
      {"version", @version},
      {"edits", mark && {:text, mark}},
      {"name", dataset.name},
      {"tags", dataset.tags},
      {"metadata", dataset.metadata}
    ]

    members = if mark, do: members, else: List.delete_at(members, 1)

    sessions = {"sessions", Enum.map(dataset.sessions, &encode_session(&1, path))}
    text = encode_pretty({:object, members ++ Enum.sort(dataset.extra) ++ [sessions]}, "")
    IO.iodata_to_binary([text, "\n"])
  end

  defp encode_session(session, path) do
    partitions = {"partitions", Enum.map(session.partitions, &encode_partition(&1, path))}
    head = [{"name", session.name}, {"tags", session.tags}, {"metadata", session.metadata}]
    {:object, Enum.reject(head, &empty_member?/1) ++ Enum.sort(session.extra) ++ [partitions]}
  end

  defp encode_partition(partition, path) do
    stored =
      if StoredPath.windows_path?(partition.path),
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

    {:object, Enum.reject(members, &empty_member?/1) ++ Enum.sort(partition.extra)}
  end

  defp empty_member?({_, value}), do: value in [nil, [], %{}]

  # Writes members in a readable order; the JSON encoder does not define one.
  defp encode_pretty({:object, members}, indent), do: encode_lines("{", members, "}", indent)
  defp encode_pretty([{:object, _} | _] = list, indent), do: encode_lines("[", list, "]", indent)
  defp encode_pretty({:text, text}, _indent), do: text
  defp encode_pretty(value, _indent), do: Situ.JSON.encode(value)

  defp encode_lines(open, items, close, indent) do
    inner = indent <> "  "
    items = Enum.map_intersperse(items, [",\n", inner], &encode_item(&1, inner))
    [open, "\n", inner, items, "\n", indent, close]
  end

  defp encode_item({key, value}, indent) when is_binary(key),
    do: [Situ.JSON.encode(key), ": ", encode_pretty(value, indent)]

  defp encode_item(value, indent), do: encode_pretty(value, indent)
end
