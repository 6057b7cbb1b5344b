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
         {:ok, server} <- start_server(studio, name, dataset) do
      :ok = Server.subscribe(server)
      {:ok, server}
    end
  end

  defp start_server(studio, name, dataset) do
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
        with {:ok, _} <- reload_dataset(pid), do: {:ok, pid}

      {:error, reason} ->
        {:error, Error.new(:not_opened, "no dataset: #{inspect(reason)}")}
    end
  end

  @doc "Applies `fun` to the current content of the dataset's file and saves the result."
  @spec edit(GenServer.server(), (Dataset.t() -> Dataset.result())) :: Dataset.result()
  def edit(server, fun), do: Server.edit(server, &Dataset.update(&1, fun))

  @doc "Reads the edits that other programs have made."
  @spec reload_dataset(GenServer.server()) :: Dataset.result()
  def reload_dataset(server), do: Server.edit(server, &Dataset.refresh/1)

  @doc "Adds a partition to a session, and replaces a partition with the same name."
  @spec put_partition(GenServer.server(), String.t(), Situ.Dataset.Partition.t()) ::
          Dataset.result()
  def put_partition(server, session, partition) do
    edit(server, fn dataset ->
      Dataset.update_session(dataset, session, fn session ->
        case Session.fetch_partition(session, partition.name) do
          {:ok, _} -> Session.replace_partition(session, partition)
          {:error, _} -> Session.add_partition(session, partition)
        end
      end)
    end)
  end
end
