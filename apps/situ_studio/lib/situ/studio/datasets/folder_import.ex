defmodule Situ.Studio.Datasets.FolderImport do
  @moduledoc false
  # Adds folders of recordings to a dataset: as one session per folder, as a single session, or as
  # recordings of an existing session. Recordings and sessions that the dataset already contains
  # are skipped and reported.
  alias Situ.Dataset
  alias Situ.Dataset.{NameRules, Partition, Session}
  alias Situ.Studio.Catalog.Item

  @typedoc "The number of items added and the names of the skipped ones."
  @type told :: {added :: non_neg_integer(), skipped :: [String.t()]}

  @doc """
  Lists the folders that contain recordings of a studio, at any depth, with their names in addresses.

      iex> item = fn id -> %Situ.Studio.Catalog.Item{id: id, title: id, kind: :store, path: "/data/" <> id} end
      iex> items = Enum.map(["p1/a/room.0000", "p2/room.0000", "talk.mp4"], item)
      iex> Situ.Studio.Datasets.FolderImport.list_folders(items)
      [{".", "/data"}, {"p1", "/data/p1"}, {"p1/a", "/data/p1/a"}, {"p2", "/data/p2"}]
  """
  @spec list_folders([Item.t()]) :: [{String.t(), Path.t()}]
  def list_folders(items) do
    for(
      %{kind: :store, id: id, path: path} <- items,
      String.ends_with?(path, "/" <> id),
      {folder, _} = found <- parent_folders(Path.dirname(id), Path.dirname(path)),
      uniq: true,
      do: if(folder == "", do: {".", elem(found, 1)}, else: found)
    )
    |> Enum.sort()
  end

  defp parent_folders(".", path), do: [{".", path}]

  defp parent_folders(id, path),
    do: [{id, path} | parent_folders(Path.dirname(id), Path.dirname(path))]

  @doc "Adds each folder in `folder`, and each recording directly in it, as a session."
  @spec add_sessions(Dataset.t(), Path.t()) ::
          {:ok, Dataset.t(), told()} | {:error, Situ.Error.t()}
  def add_sessions(dataset, folder) do
    with {:ok, found} <- Dataset.open(folder), do: append_sessions(dataset, found.sessions)
  end

  @doc "Adds all recordings in and below `folder` as one session named after the folder."
  @spec add_session(Dataset.t(), Path.t()) ::
          {:ok, Dataset.t(), told()} | {:error, Situ.Error.t()}
  def add_session(dataset, folder) do
    with {:ok, found} <- Dataset.open(folder) do
      name = NameRules.make_unique(Path.basename(folder), Enum.map(dataset.sessions, & &1.name))
      {session, told} = fill_session(Session.new(name), found, recording_paths(dataset))

      if elem(told, 0) == 0,
        do: {:ok, dataset, told},
        else: append_sessions(dataset, [session], told)
    end
  end

  @doc "Adds all recordings in and below `folder` to a session."
  @spec add_recordings(Dataset.t(), String.t(), Path.t()) ::
          {:ok, Dataset.t(), told()} | {:error, Situ.Error.t()}
  def add_recordings(dataset, name, folder) do
    with {:ok, found} <- Dataset.open(folder),
         {:ok, session} <- Dataset.session(dataset, name),
         taken = MapSet.new(session.partitions, & &1.path),
         {session, told} = fill_session(session, found, taken),
         {:ok, dataset} <- Dataset.update_session(dataset, name, fn _ -> {:ok, session} end),
         do: {:ok, dataset, told}
  end

  defp append_sessions(dataset, sessions), do: append_sessions(dataset, sessions, {0, []})

  # Adding all sessions in one edit saves the dataset only once.
  defp append_sessions(dataset, sessions, {_, skipped}) do
    names = MapSet.new(dataset.sessions, & &1.name)
    {there, new} = Enum.split_with(sessions, &(&1.name in names))

    with {:ok, dataset} <- Dataset.append_sessions(dataset, %Dataset{sessions: new}),
         do: {:ok, dataset, {length(new), skipped ++ Enum.map(there, & &1.name)}}
  end

  defp fill_session(session, %Dataset{sessions: found}, taken) do
    partitions = Enum.flat_map(found, & &1.partitions)
    {there, new} = Enum.split_with(partitions, &(&1.path in taken))
    session = Enum.reduce(new, session, &put_partition/2)
    {session, {length(new), Enum.map(there, & &1.name)}}
  end

  defp put_partition(%Partition{} = partition, session) do
    name = NameRules.make_unique(partition.name, Enum.map(session.partitions, & &1.name))
    {:ok, session} = Session.add_partition(session, %{partition | name: name})
    session
  end

  defp recording_paths(dataset),
    do: for(s <- dataset.sessions, p <- s.partitions, into: MapSet.new(), do: p.path)

  @doc """
  Describes the result for the page.

      iex> Situ.Studio.Datasets.FolderImport.describe_result({2, ["p01", "p02"]}, "session")
      "2 sessions added; already present: p01, p02"
      iex> Situ.Studio.Datasets.FolderImport.describe_result({1, []}, "recording")
      "1 recording added"
  """
  @spec describe_result(told(), String.t()) :: String.t()
  def describe_result({added, skipped}, noun) do
    "#{added} #{noun}#{if added != 1, do: "s"} added" <>
      case Enum.split(skipped, 5) do
        {[], []} -> ""
        {some, []} -> "; already present: #{Enum.join(some, ", ")}"
        {some, more} -> "; already present: #{Enum.join(some, ", ")} and #{length(more)} more"
      end
  end
end
