defmodule Situ.Application.Directory do
  @moduledoc false
  # The pipelines of this node. Each pipeline has an entry with its label. A pipeline whose `name:` is an atom,
  # `{:via, module, key}` or `{:global, key}` is also registered under that name. One process monitors them all (a
  # `Registry` would link itself to each pipeline).
  use GenServer
  alias Situ.Error

  @table __MODULE__

  @spec start_link(term()) :: GenServer.on_start()
  def start_link(_), do: GenServer.start_link(__MODULE__, [], name: __MODULE__)

  @doc "Registers the calling process as a pipeline; does nothing if the directory process is not running."
  @spec register_pipeline(%{
          :name => String.t(),
          :registered => GenServer.name() | nil,
          optional(atom()) => term()
        }) ::
          :ok | {:error, Error.t()}
  def register_pipeline(settings) do
    with :ok <- register_name(settings.registered),
         do: GenServer.call(__MODULE__, {:enter, settings.name})
  catch
    :exit, _ -> :ok
  end

  defp register_name(nil), do: :ok

  defp register_name({:via, module, key} = name), do: register_key(module, key, name)
  defp register_name({:global, key} = name), do: register_key(:global, key, name)

  defp register_name(name) do
    Process.register(self(), name)
    :ok
  rescue
    ArgumentError -> {:error, name_taken_error(name)}
  end

  defp register_key(module, key, name) do
    case module.register_name(key, self()) do
      :yes -> :ok
      :no -> {:error, name_taken_error(name)}
    end
  rescue
    error ->
      {:error,
       Error.new(:name_taken, "cannot register the pipeline as #{inspect(name)}",
         why: Exception.message(error),
         fix: "start the registry before the pipeline"
       )}
  end

  @doc "Releases the name of the calling process, so that it is free before any other process sees the pipeline end."
  @spec unregister_pipeline(%{
          :registered => GenServer.name() | nil,
          optional(atom()) => term()
        }) :: :ok
  def unregister_pipeline(%{registered: name}) do
    unregister_name(name)
    GenServer.call(__MODULE__, :leave)
  catch
    :exit, _ -> :ok
  end

  defp unregister_name(nil), do: :ok

  defp unregister_name(name) do
    if GenServer.whereis(name) == self() do
      case name do
        {:via, module, key} -> module.unregister_name(key)
        {:global, key} -> :global.unregister_name(key)
        name -> Process.unregister(name)
      end
    end
  rescue
    # The registry has ended before the pipeline.
    ArgumentError -> :ok
  end

  @doc "Returns the label and process of each pipeline, sorted by label."
  @spec list_pipelines() :: [{String.t(), pid()}]
  def list_pipelines, do: for({pid, label} <- live_entries(:_), do: {label, pid}) |> Enum.sort()

  @doc "Returns the pipeline with this label. Raises `Situ.Error` (`:ambiguous_name`) if several pipelines have it."
  @spec whereis(String.t()) :: pid() | nil
  def whereis(label) do
    case live_entries(label) do
      [] -> nil
      [{pid, _}] -> pid
      several -> raise ambiguous_name_error(label, length(several))
    end
  end

  # A pipeline that has just ended may still have an entry.
  defp live_entries(label) do
    for {pid, _} = entry <- :ets.match_object(@table, {:_, label}), Process.alive?(pid), do: entry
  end

  @impl true
  def init(_) do
    :ets.new(@table, [:named_table, :protected, :set, read_concurrency: true])
    {:ok, nil}
  end

  @impl true
  def handle_call({:enter, label}, {pid, _}, state) do
    Process.monitor(pid)
    :ets.insert(@table, {pid, label})
    {:reply, :ok, state}
  end

  def handle_call(:leave, {pid, _}, state) do
    :ets.delete(@table, pid)
    {:reply, :ok, state}
  end

  @impl true
  def handle_info({:DOWN, _ref, :process, pid, _reason}, state) do
    :ets.delete(@table, pid)
    {:noreply, state}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp name_taken_error(name) do
    Error.new(:name_taken, "the name #{inspect(name)} is not available",
      why: "another process is registered under it, or the name is reserved",
      fix: "give the pipeline a different name:"
    )
  end

  defp ambiguous_name_error(label, n) do
    Error.new(:ambiguous_name, "#{n} pipelines are called #{inspect(label)}",
      fix: "use the pid (Situ.Pipeline.list/0 lists them), or give each pipeline a unique name"
    )
  end
end
