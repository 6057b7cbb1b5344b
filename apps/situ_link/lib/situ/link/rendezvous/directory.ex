defmodule Situ.Link.Rendezvous.Directory do
  @moduledoc false
  # Keeps the announced processes, each with the client that owns it. Pure.
  alias Situ.Link.Rendezvous.Protocol

  # These limits keep a client with many names or long lists from filling the memory or locking out other clients.
  @max_processes 1_000
  @max_per_owner 100
  @max_bytes 16 * 1024 * 1024

  defstruct processes: %{}, bytes: 0
  @type t :: %__MODULE__{}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @spec list_processes(t()) :: [Protocol.process()]
  def list_processes(%__MODULE__{processes: processes}),
    do: for({_name, {_owner, process}} <- Enum.sort(processes), do: process)

  @doc "Returns the clients that have announced at least one process."
  @spec list_owners(t()) :: MapSet.t()
  def list_owners(%__MODULE__{processes: processes}),
    do: MapSet.new(processes, fn {_name, {owner, _process}} -> owner end)

  @doc """
  Applies an update from a client and returns the updates to send to all others. A process that is added again with
  different endpoints is sent as a removal and an addition, which every client understands. An update for a name that
  belongs to another client is ignored.

      iex> alias Situ.Link.Rendezvous.Directory
      iex> robot = %{name: "robot", version: "1", endpoints: []}
      iex> {[{:add, ^robot}], directory} = Directory.apply_update(Directory.new(), :a, {:add, robot})
      iex> {[], directory} = Directory.apply_update(directory, :b, {:remove, "robot"})
      iex> {updates, _} = Directory.remove_owner(directory, :a)
      iex> updates
      [{:remove, "robot"}]
  """
  @spec apply_update(t(), term(), Protocol.update()) :: {[Protocol.update()], t()}
  def apply_update(%__MODULE__{} = directory, owner, {:add, %{name: name} = process}) do
    case directory.processes do
      %{^name => {^owner, ^process}} ->
        {[], directory}

      %{^name => {^owner, _other}} ->
        directory = remove_process(directory, name)

        if has_room?(directory, owner, process),
          do: {[{:remove, name}, {:add, process}], put_process(directory, owner, process)},
          else: {[{:remove, name}], directory}

      %{^name => _somebody_elses} ->
        {[], directory}

      _ ->
        if has_room?(directory, owner, process),
          do: {[{:add, process}], put_process(directory, owner, process)},
          else: {[], directory}
    end
  end

  def apply_update(%__MODULE__{} = directory, owner, {:remove, name}) do
    case directory.processes do
      %{^name => {^owner, _}} -> {[{:remove, name}], remove_process(directory, name)}
      _ -> {[], directory}
    end
  end

  def apply_update(%__MODULE__{} = directory, owner, :disconnect),
    do: remove_owner(directory, owner)

  defp has_room?(%{processes: processes, bytes: bytes}, owner, process) do
    map_size(processes) < @max_processes and bytes + :erlang.external_size(process) <= @max_bytes and
      Enum.count(processes, fn {_, {other, _}} -> other == owner end) < @max_per_owner
  end

  defp put_process(directory, owner, process) do
    processes = Map.put(directory.processes, process.name, {owner, process})
    bytes = directory.bytes + :erlang.external_size(process)
    %{directory | processes: processes, bytes: bytes}
  end

  defp remove_process(directory, name) do
    {{_owner, process}, processes} = Map.pop!(directory.processes, name)
    bytes = directory.bytes - :erlang.external_size(process)
    %{directory | processes: processes, bytes: bytes}
  end

  @doc "Removes a client that has left, with all its processes."
  @spec remove_owner(t(), term()) :: {[Protocol.update()], t()}
  def remove_owner(%__MODULE__{processes: processes} = directory, owner) do
    names = for {name, {^owner, _}} <- processes, do: name
    updates = for name <- Enum.sort(names), do: {:remove, name}
    {updates, Enum.reduce(names, directory, &remove_process(&2, &1))}
  end

  @doc "Describes for people that a name is taken: of two processes with the same name, the first counts."
  @spec name_taken_text(String.t()) :: String.t()
  def name_taken_text(name),
    do:
      "another process is already named #{inspect(name)}, and the others see only that one; give each a unique name"
end
