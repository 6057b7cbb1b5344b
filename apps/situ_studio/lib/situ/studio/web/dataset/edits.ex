defmodule Situ.Studio.Web.Dataset.Edits do
  @moduledoc false
  # Edits from a dataset's page. Each event either becomes an edit by the dataset's process, or
  # opens a dialog that asks for the values the edit needs.
  alias Situ.{Dataset, Error}
  alias Situ.Dataset.{Partition, Session}
  alias Situ.Studio.{Catalog, Datasets, Export}
  alias Situ.Studio.Datasets.{Deletion, Summary, FolderImport}
  alias Situ.Studio.Web.Paths
  alias Situ.Studio.Web.Dataset.Rows

  @doc """
  Returns the path of the row that an event refers to: a list of names, which a click sends as JSON.

      iex> Situ.Studio.Web.Dataset.Edits.parse_path(%{"path" => ~s(["p01", "Room"])})
      ["p01", "Room"]
  """
  @spec parse_path(map()) :: [String.t()]
  def parse_path(%{"path" => text}) when is_binary(text) do
    case Situ.JSON.decode(text) do
      {:ok, path} -> parse_path(%{"path" => path})
      {:error, _} -> []
    end
  end

  def parse_path(%{"path" => path}) when is_list(path), do: Enum.filter(path, &is_binary/1)
  def parse_path(_), do: []

  @doc "Applies an event and returns the page's changed assigns, or an error to show."
  @spec apply_event(String.t(), map(), map()) :: {:ok, keyword()} | {:error, Error.t()} | :ignore
  def apply_event("ask", %{"what" => what} = params, _assigns)
      when what in ["session", "rename", "copy"] do
    path = parse_path(params)
    old = if what == "rename", do: List.last(path), else: ""
    {:ok, dialog: {:ask, what, path, old}}
  end

  def apply_event("answer", %{"text" => text}, %{dialog: {:ask, "session", _, _}} = assigns),
    do: edit_dataset(assigns, &Dataset.add_session(&1, String.trim(text)))

  # Saves a copy under another name in the same folder, as a new starting point or because this format is read-only.
  def apply_event("answer", %{"text" => text}, %{dialog: {:ask, "copy", _, _}} = assigns) do
    %{dataset: dataset, file: file, id: id} = assigns
    name = text |> String.trim() |> String.replace_suffix(".json", "")

    with :ok <- Export.check_name(name),
         copy = Path.join(Path.dirname(file), name <> ".json"),
         false <- File.exists?(copy),
         {:ok, _} <- Dataset.save_as(%{dataset | autosave?: false}, copy) do
      Catalog.invalidate_recordings(assigns.studio)
      at = id |> Path.dirname() |> Path.join(name <> ".json") |> Path.relative_to("./")
      {:ok, dialog: nil, go: Paths.dataset_path(at)}
    else
      true ->
        {:error, Error.new(:exists, "#{name}.json already exists", fix: "choose another name")}

      {:error, error} ->
        {:error, error}
    end
  end

  def apply_event(
        "answer",
        %{"text" => text},
        %{dialog: {:ask, "rename", [session], _}} = assigns
      ) do
    name = String.trim(text)

    with {:ok, changes} <- edit_dataset(assigns, &Dataset.rename_session(&1, session, name)),
         do: {:ok, changes ++ [selected: [name]]}
  end

  def apply_event("answer", %{"text" => text}, %{dialog: {:ask, _, [session, old], _}} = assigns) do
    name = String.trim(text)
    rename = &Session.rename_partition(&1, old, name)

    with {:ok, changes} <- edit_dataset(assigns, &Dataset.update_session(&1, session, rename)),
         do: {:ok, changes ++ [selected: [session, name]]}
  end

  def apply_event("recordings", params, assigns),
    do: {:ok, dialog: {:recordings, parse_path(params), unused_recordings(assigns)}}

  def apply_event("relocate", params, assigns),
    do: {:ok, dialog: {:relocate, parse_path(params), unused_recordings(assigns)}}

  def apply_event(
        "take",
        %{"chosen" => id},
        %{dialog: {:relocate, [session, name], free}} = assigns
      ) do
    case List.keyfind(free, id, 0) do
      {_, file} -> edit_dataset(assigns, &replace_recording(&1, session, name, file))
      nil -> :ignore
    end
  end

  def apply_event("folders", %{"what" => what} = params, assigns)
      when what in ["session", "sessions", "recordings"] do
    {:ok,
     dialog:
       {:folders, what, parse_path(params),
        FolderImport.list_folders(Catalog.list(assigns.studio))}}
  end

  def apply_event(
        "add_folder",
        %{"folder" => id},
        %{dialog: {:folders, what, path, folders}} = assigns
      ) do
    with {_, folder} <- List.keyfind(folders, id, 0) do
      noun = if what == "recordings", do: "recording", else: "session"
      ref = make_ref()
      page = self()

      add = fn dataset ->
        with {:ok, dataset, result} <- add_folder(what, dataset, path, folder) do
          send(page, {ref, result})
          {:ok, dataset}
        end
      end

      with {:ok, changes} <- edit_dataset(assigns, add) do
        receive do
          {^ref, result} -> {:ok, changes ++ [toast: FolderImport.describe_result(result, noun)]}
        after
          0 -> {:ok, changes}
        end
      end
    else
      nil -> :ignore
    end
  end

  def apply_event("export", params, assigns) do
    with [session, name] <- parse_path(params),
         {:ok, found} <- Dataset.session(assigns.dataset, session),
         {:ok, partition} <- Session.fetch_partition(found, name),
         %Summary{error: nil, from: from} = facts when from != nil <-
           Summary.of_recording(partition.path) do
      item = %Catalog.Item{id: name, title: name, kind: :store, path: partition.path}
      {:ok, dialog: {:export, item, facts}}
    else
      %Summary{error: nil} -> {:error, Error.new(:empty, "the recording has no messages")}
      %Summary{error: error} -> {:error, error}
      {:error, error} -> {:error, error}
      _ -> :ignore
    end
  end

  def apply_event("add_recordings", params, %{dialog: {:recordings, path, free}} = assigns) do
    chosen = for {id, file} <- free, Map.has_key?(params["chosen"] || %{}, id), do: file

    edit_dataset(
      assigns,
      &Enum.reduce_while(chosen, {:ok, &1}, fn file, {:ok, d} -> add_recording(d, path, file) end)
    )
  end

  def apply_event("remove", params, assigns) do
    case parse_path(params) do
      [session] ->
        edit_dataset(assigns, &Dataset.remove_session(&1, session), selected: [])

      [session, partition] ->
        edit_dataset(
          assigns,
          &Dataset.update_session(&1, session, fn s -> Session.remove_partition(s, partition) end),
          selected: [session]
        )

      _ ->
        :ignore
    end
  end

  def apply_event("remove_all", params, assigns) do
    case parse_path(params) do
      [_, name] ->
        edit_dataset(assigns, &remove_all(&1, name), selected: [])

      _ ->
        :ignore
    end
  end

  # The recordings are deleted first, so that a recording whose deletion fails stays in the dataset.
  def apply_event("delete", params, assigns) do
    case parse_path(params) do
      [session] ->
        with {:ok, found} <- Dataset.session(assigns.dataset, session),
             :ok <-
               Deletion.delete_partitions(
                 assigns.dataset,
                 for(p <- found.partitions, do: {session, p})
               ),
             do: edit_dataset(assigns, &Dataset.remove_session(&1, session), selected: [])

      [session, name] ->
        with {:ok, found} <- Dataset.session(assigns.dataset, session),
             {:ok, partition} <- Session.fetch_partition(found, name),
             :ok <- Deletion.delete_partitions(assigns.dataset, [{session, partition}]) do
          remove = fn dataset ->
            Dataset.update_session(dataset, session, &Session.remove_partition(&1, name))
          end

          edit_dataset(assigns, remove, selected: [session])
        end

      _ ->
        :ignore
    end
  end

  def apply_event("delete_all", params, assigns) do
    with [_, name] <- parse_path(params),
         all =
           for(s <- assigns.dataset.sessions, p <- s.partitions, p.name == name, do: {s.name, p}),
         :ok <- Deletion.delete_partitions(assigns.dataset, all) do
      edit_dataset(assigns, &remove_all(&1, name), selected: [])
    else
      {:error, error} -> {:error, error}
      _ -> :ignore
    end
  end

  def apply_event("seal", _, assigns), do: edit_dataset(assigns, &Dataset.seal/1)

  def apply_event("save_properties", params, %{selected: selected} = assigns) do
    with {:ok, metadata} <- Rows.parse_metadata(text_param(params["metadata"])) do
      tags =
        params["tags"]
        |> text_param()
        |> String.split([",", "\n"])
        |> Enum.map(&String.trim/1)
        |> Enum.reject(&(&1 == ""))
        |> Enum.uniq()

      edit_dataset(assigns, &put_properties(&1, selected, metadata, tags, params))
    end
  end

  def apply_event(_, _, _), do: :ignore

  defp put_properties(dataset, [], metadata, tags, params) do
    name = String.trim(text_param(params["name"]))

    Dataset.put_fields(dataset,
      metadata: metadata,
      tags: tags,
      name: if(name == "", do: dataset.name, else: name)
    )
  end

  defp put_properties(dataset, [session], metadata, tags, _),
    do: Dataset.update_session(dataset, session, &{:ok, %{&1 | metadata: metadata, tags: tags}})

  defp put_properties(dataset, [session, partition | _], metadata, _, _) do
    Dataset.update_session(dataset, session, fn session ->
      with {:ok, found} <- Session.fetch_partition(session, partition),
           do: Session.replace_partition(session, %{found | metadata: metadata})
    end)
  end

  # Adds the file as a new session, or to an existing one.
  defp add_recording(dataset, [], file), do: reduce_step(Dataset.add_recording(dataset, file))

  defp add_recording(dataset, [session | _], file),
    do: reduce_step(Dataset.add_partition(dataset, session, nil, file))

  defp reduce_step({:ok, dataset}), do: {:cont, {:ok, dataset}}
  defp reduce_step(error), do: {:halt, error}

  defp remove_all(dataset, name) do
    Enum.reduce_while(dataset.sessions, {:ok, dataset}, fn session, {:ok, dataset} ->
      if Enum.any?(session.partitions, &(&1.name == name)),
        do:
          reduce_step(
            Dataset.update_session(dataset, session.name, &Session.remove_partition(&1, name))
          ),
        else: {:cont, {:ok, dataset}}
    end)
  end

  defp unused_recordings(assigns) do
    taken = for s <- assigns.dataset.sessions, p <- s.partitions, into: MapSet.new(), do: p.path

    for %{kind: :store} = item <- Catalog.list(assigns.studio),
        item.path not in taken,
        do: {item.id, item.path}
  end

  # Points a partition to another file after its recording was moved or renamed. Its metadata is kept.
  defp replace_recording(dataset, session, name, file) do
    Dataset.update_session(dataset, session, fn session ->
      with {:ok, old} <- Session.fetch_partition(session, name) do
        new = Partition.new(name, file)
        Session.replace_partition(session, %{new | metadata: old.metadata, extra: old.extra})
      end
    end)
  end

  defp add_folder("sessions", dataset, _path, folder),
    do: FolderImport.add_sessions(dataset, folder)

  defp add_folder("session", dataset, _path, folder),
    do: FolderImport.add_session(dataset, folder)

  defp add_folder("recordings", dataset, [session | _], folder),
    do: FolderImport.add_recordings(dataset, session, folder)

  @doc "Parses the time range of an export form, given as times or as seconds after the recording's start."
  @spec parse_export(map(), {:export, Catalog.Item.t(), Summary.t()}) ::
          {:ok, Export.t(), Catalog.Item.t()} | {:error, Error.t()}
  def parse_export(params, {:export, item, facts}) do
    with {:ok, from} <- parse_time(text_param(params["from"]), facts, facts.from),
         {:ok, to} <- parse_time(text_param(params["to"]), facts, facts.to),
         {:ok, export} <- Export.new(text_param(params["name"]), from, to, :all),
         do: {:ok, export, item}
  end

  defp parse_time(text, facts, usual) do
    text = String.trim(text)

    case {text, Float.parse(text), Situ.Time.parse(text)} do
      {"", _, _} ->
        {:ok, usual}

      {_, {seconds, ""}, _} when seconds >= 0 ->
        {:ok, facts.from + round(seconds * 1.0e9)}

      {_, _, {:ok, time}} ->
        {:ok, time}

      _ ->
        {:error,
         Error.new(:bad_time, "invalid time: #{text}",
           fix:
             "write a time such as 2026-01-31T12:34:56Z, or seconds after the start such as 12.5"
         )}
    end
  end

  defp edit_dataset(assigns, fun, changes \\ []) do
    with {:ok, dataset} <- Datasets.edit(assigns.server, fun),
         do: {:ok, [dataset: dataset, dialog: nil] ++ changes}
  end

  defp text_param(value), do: if(is_binary(value), do: String.slice(value, 0, 100_000), else: "")
end
