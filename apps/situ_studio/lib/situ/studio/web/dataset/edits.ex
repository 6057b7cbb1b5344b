defmodule Situ.Studio.Web.Dataset.Edits do
  @moduledoc """
  The edits of a dataset's page: each event becomes an edit by the dataset's process, or a dialog that asks for the
  values the edit needs.
  """
  alias Situ.{Dataset, Error}
  alias Situ.Dataset.{Partition, Session}
  alias Situ.Studio.{Catalog, Datasets}
  alias Situ.Studio.Web.Dataset.Rows

  @doc """
  The row an event is about: a list of names, as JSON where it comes with a click.

      iex> Situ.Studio.Web.Dataset.Edits.path(%{"path" => ~s(["p01", "Room"])})
      ["p01", "Room"]
  """
  @spec path(map()) :: [String.t()]
  def path(%{"path" => text}) when is_binary(text) do
    case Situ.JSON.decode(text) do
      {:ok, path} -> path(%{"path" => path})
      {:error, _} -> []
    end
  end

  def path(%{"path" => path}) when is_list(path), do: Enum.filter(path, &is_binary/1)
  def path(_), do: []

  @doc "The page's new assigns, or an error to show."
  @spec apply(String.t(), map(), map()) :: {:ok, keyword()} | {:error, Error.t()} | :ignore
  def apply("ask", %{"what" => what} = params, _assigns) when what in ["session", "rename"] do
    path = path(params)
    old = if what == "rename", do: List.last(path), else: ""
    {:ok, dialog: {:ask, what, path, old}}
  end

  def apply("answer", %{"text" => text}, %{dialog: {:ask, "session", _, _}} = assigns),
    do: edited(assigns, &Dataset.add_session(&1, String.trim(text)))

  def apply("answer", %{"text" => text}, %{dialog: {:ask, "rename", [session], _}} = assigns) do
    name = String.trim(text)

    with {:ok, changes} <- edited(assigns, &Dataset.rename_session(&1, session, name)),
         do: {:ok, changes ++ [selected: [name]]}
  end

  def apply("answer", %{"text" => text}, %{dialog: {:ask, _, [session, old], _}} = assigns) do
    name = String.trim(text)
    rename = &Session.rename_partition(&1, old, name)

    with {:ok, changes} <- edited(assigns, &Dataset.update_session(&1, session, rename)),
         do: {:ok, changes ++ [selected: [session, name]]}
  end

  def apply("recordings", params, assigns) do
    taken = for s <- assigns.dataset.sessions, p <- s.partitions, into: MapSet.new(), do: p.path

    free =
      for %{kind: :store} = item <- Catalog.list(assigns.studio),
          item.path not in taken,
          do: {item.id, item.path}

    {:ok, dialog: {:recordings, path(params), free}}
  end

  def apply("add_recordings", params, %{dialog: {:recordings, path, free}} = assigns) do
    chosen = for {id, file} <- free, Map.has_key?(params["chosen"] || %{}, id), do: file

    edited(
      assigns,
      &Enum.reduce_while(chosen, {:ok, &1}, fn file, {:ok, d} -> add(d, path, file) end)
    )
  end

  def apply("remove", params, assigns) do
    case path(params) do
      [session] ->
        edited(assigns, &Dataset.remove_session(&1, session), selected: [])

      [session, partition] ->
        edited(
          assigns,
          &Dataset.update_session(&1, session, fn s -> Session.remove(s, partition) end),
          selected: [session]
        )

      _ ->
        :ignore
    end
  end

  def apply("remove_all", params, assigns) do
    case path(params) do
      [_, name] ->
        edited(assigns, &remove_all(&1, name), selected: [])

      _ ->
        :ignore
    end
  end

  def apply("delete", params, assigns) do
    with [session, name] <- path(params),
         {:ok, found} <- Dataset.session(assigns.dataset, session),
         {:ok, partition} <- Session.partition(found, name),
         :ok <- delete(partition) do
      edited(assigns, &Dataset.update_session(&1, session, fn s -> Session.remove(s, name) end),
        selected: [session]
      )
    else
      {:error, error} -> {:error, error}
      _ -> :ignore
    end
  end

  def apply("seal", _, assigns), do: edited(assigns, &Dataset.seal/1)

  def apply("save_properties", params, %{selected: selected} = assigns) do
    with {:ok, metadata} <- Rows.metadata(text(params["metadata"])) do
      tags =
        params["tags"]
        |> text()
        |> String.split([",", "\n"])
        |> Enum.map(&String.trim/1)
        |> Enum.reject(&(&1 == ""))
        |> Enum.uniq()

      edited(assigns, &properties(&1, selected, metadata, tags, params))
    end
  end

  def apply(_, _, _), do: :ignore

  defp properties(dataset, [], metadata, tags, params) do
    name = String.trim(text(params["name"]))

    Dataset.put(dataset,
      metadata: metadata,
      tags: tags,
      name: if(name == "", do: dataset.name, else: name)
    )
  end

  defp properties(dataset, [session], metadata, tags, _),
    do: Dataset.update_session(dataset, session, &{:ok, %{&1 | metadata: metadata, tags: tags}})

  defp properties(dataset, [session, partition | _], metadata, _, _) do
    Dataset.update_session(dataset, session, fn session ->
      with {:ok, found} <- Session.partition(session, partition),
           do: Session.replace(session, %{found | metadata: metadata})
    end)
  end

  # A session each, or all into one.
  defp add(dataset, [], file), do: step(Dataset.add_recording(dataset, file))

  defp add(dataset, [session | _], file),
    do: step(Dataset.add_partition(dataset, session, nil, file))

  defp step({:ok, dataset}), do: {:cont, {:ok, dataset}}
  defp step(error), do: {:halt, error}

  defp remove_all(dataset, name) do
    Enum.reduce_while(dataset.sessions, {:ok, dataset}, fn session, {:ok, dataset} ->
      if Enum.any?(session.partitions, &(&1.name == name)),
        do: step(Dataset.update_session(dataset, session.name, &Session.remove(&1, name))),
        else: {:cont, {:ok, dataset}}
    end)
  end

  defp delete(%Partition{path: path}) do
    with {:ok, store} <- Situ.Store.open(path),
         false <- Situ.Store.live?(store) do
      Situ.Store.delete(path)
    else
      true ->
        {:error,
         Error.new(:live, "it is being recorded: #{path}", fix: "delete it when that has ended")}

      {:error, error} ->
        {:error, error}
    end
  end

  defp edited(assigns, fun, changes \\ []) do
    with {:ok, dataset} <- Datasets.edit(assigns.server, assigns.file, fun),
         do: {:ok, [dataset: dataset, dialog: nil] ++ changes}
  end

  defp text(value), do: if(is_binary(value), do: String.slice(value, 0, 100_000), else: "")
end
