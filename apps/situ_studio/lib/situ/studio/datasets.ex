defmodule Situ.Studio.Datasets do
  @moduledoc """
  The datasets that pages of a studio look at: one process for each (`Situ.Dataset.Server`), which every page and batch
  run edits through. The file is the truth: an edit begins with what is in it now, so that one made by hand or by the
  command line meanwhile is not lost.
  """
  alias Situ.{Dataset, Error}
  alias Situ.Dataset.{Server, Session}
  alias Situ.Studio.Catalog

  @doc "The process of the dataset in `file`; the caller gets its changes, see `Situ.Dataset.Server`."
  @spec open(Catalog.id(), Path.t()) :: {:ok, pid()} | {:error, Error.t()}
  def open(studio, file) do
    name = {:via, Registry, {Situ.Studio.Registry, {studio, :dataset, file}}}

    with {:ok, dataset} <- Dataset.load(file, autosave: true),
         {:ok, server} <- started(studio, name, dataset) do
      :ok = Server.subscribe(server)
      {:ok, server}
    end
  end

  defp started(studio, name, dataset) do
    child = %{
      id: Server,
      start: {Server, :start_link, [[dataset: dataset, name: name]]},
      restart: :temporary
    }

    case DynamicSupervisor.start_child(Catalog.watches(studio), child) do
      {:ok, pid} -> {:ok, pid}
      {:error, {:already_started, pid}} -> {:ok, pid}
      {:error, reason} -> {:error, Error.new(:not_opened, "the dataset: #{inspect(reason)}")}
    end
  end

  @doc "Changes a dataset as its file is now, and saves it."
  @spec edit(GenServer.server(), Path.t(), (Dataset.t() -> Dataset.result())) :: Dataset.result()
  def edit(server, file, fun) do
    Server.edit(server, fn held ->
      with {:ok, dataset} <- current(held, file), do: Dataset.update(dataset, fun)
    end)
  end

  # A dataset that cannot be saved under its own name (a .pds) stays as it was read.
  defp current(%Dataset{file: nil} = held, _file), do: {:ok, held}
  defp current(_held, file), do: Dataset.load(file, autosave: true)

  @doc "Reads the file again."
  @spec refresh(GenServer.server(), Path.t()) :: Dataset.result()
  def refresh(server, file), do: Server.edit(server, &current(&1, file))

  @doc "Takes a partition into a session, in the place of one of its name."
  @spec put_partition(GenServer.server(), Path.t(), String.t(), Situ.Dataset.Partition.t()) ::
          Dataset.result()
  def put_partition(server, file, session, partition) do
    edit(server, file, fn dataset ->
      Dataset.update_session(dataset, session, fn session ->
        case Session.partition(session, partition.name) do
          {:ok, _} -> Session.replace(session, partition)
          {:error, _} -> Session.add(session, partition)
        end
      end)
    end)
  end
end
