defmodule Situ.Studio.Datasets do
  @moduledoc false
  # Keeps the datasets that are open in a studio. Each has one process (`Situ.Dataset.Server`),
  # through which all pages and batch runs edit it. The file is authoritative: an edit is applied
  # to its current content, so that changes made by hand or on the command line are not lost.
  alias Situ.{Dataset, Error}
  alias Situ.Dataset.{Server, Session}
  alias Situ.Studio.Catalog

  @doc "Returns the process of the dataset in `file` and subscribes the caller, see `Situ.Dataset.Server`."
  @spec open_server(Catalog.id(), Path.t()) :: {:ok, pid()} | {:error, Error.t()}
  def open_server(studio, file) do
    name = {:via, Registry, {Situ.Studio.Registry, {studio, :dataset, file}}}

    with {:ok, dataset} <- Dataset.load(file, autosave: true),
         {:ok, server} <- start_server(studio, name, dataset, file) do
      :ok = Server.subscribe(server)
      {:ok, server}
    end
  end

  defp start_server(studio, name, dataset, file) do
    child = %{
      id: Server,
      start: {Server, :start_link, [[dataset: dataset, name: name]]},
      restart: :temporary
    }

    case DynamicSupervisor.start_child(Catalog.watch_supervisor(studio), child) do
      {:ok, pid} ->
        {:ok, pid}

      # The file may have changed since the process read it.
      {:error, {:already_started, pid}} ->
        with {:ok, _} <- reload_dataset(pid, file), do: {:ok, pid}

      {:error, reason} ->
        {:error, Error.new(:not_opened, "no dataset: #{inspect(reason)}")}
    end
  end

  @doc "Applies `fun` to the current content of the dataset's file and saves the result."
  @spec edit(GenServer.server(), Path.t(), (Dataset.t() -> Dataset.result())) :: Dataset.result()
  def edit(server, file, fun) do
    Server.edit(server, fn dataset ->
      with {:ok, dataset} <- current(dataset, file), do: Dataset.update(dataset, fun)
    end)
  end

  # A dataset that cannot be saved under its name (a .pds file) keeps the content that was read when it was opened.
  defp current(%Dataset{file: nil} = dataset, _file), do: {:ok, dataset}
  defp current(_dataset, file), do: Dataset.load(file, autosave: true)

  @doc "Reloads the file."
  @spec reload_dataset(GenServer.server(), Path.t()) :: Dataset.result()
  def reload_dataset(server, file), do: Server.edit(server, &current(&1, file))

  @doc "Adds a partition to a session, and replaces a partition with the same name."
  @spec put_partition(GenServer.server(), Path.t(), String.t(), Situ.Dataset.Partition.t()) ::
          Dataset.result()
  def put_partition(server, file, session, partition) do
    edit(server, file, fn dataset ->
      Dataset.update_session(dataset, session, fn session ->
        case Session.fetch_partition(session, partition.name) do
          {:ok, _} -> Session.replace_partition(session, partition)
          {:error, _} -> Session.add_partition(session, partition)
        end
      end)
    end)
  end
end
