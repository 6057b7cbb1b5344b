defmodule Situ.Remote.Rendezvous.Directory do
  @moduledoc """
  Which processes there are, and whose each of them is. Pure.

      iex> alias Situ.Remote.Rendezvous.Directory
      iex> robot = %{name: "robot", version: "1", endpoints: []}
      iex> {[{:add, ^robot}], directory} = Directory.apply(Directory.new(), :a, {:add, robot})
      iex> {[], directory} = Directory.apply(directory, :b, {:remove, "robot"})
      iex> {told, _} = Directory.gone(directory, :a)
      iex> told
      [{:remove, "robot"}]
  """
  alias Situ.Remote.Rendezvous.Wire

  # One client with many names, or long lists, neither fills the memory nor shuts others out.
  @most 1_000
  @most_each 100
  @most_bytes 16 * 1024 * 1024

  defstruct processes: %{}, bytes: 0
  @type t :: %__MODULE__{}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @spec processes(t()) :: [Wire.process()]
  def processes(%__MODULE__{processes: processes}),
    do: for({_name, {_owner, process}} <- Enum.sort(processes), do: process)

  @doc "The clients that have announced something."
  @spec owners(t()) :: MapSet.t()
  def owners(%__MODULE__{processes: processes}),
    do: MapSet.new(processes, fn {_name, {owner, _process}} -> owner end)

  @doc """
  An update of a client's: what all others are to be told. A process added once more with other endpoints is told as
  gone and there again, which every client understands; one of a name that is another client's is ignored.
  """
  @spec apply(t(), term(), Wire.update()) :: {[Wire.update()], t()}
  def apply(%__MODULE__{} = directory, owner, {:add, %{name: name} = process}) do
    case directory.processes do
      %{^name => {^owner, ^process}} ->
        {[], directory}

      %{^name => {^owner, _other}} ->
        directory = remove(directory, name)

        if room?(directory, owner, process),
          do: {[{:remove, name}, {:add, process}], put(directory, owner, process)},
          else: {[{:remove, name}], directory}

      %{^name => _somebody_elses} ->
        {[], directory}

      _ ->
        if room?(directory, owner, process),
          do: {[{:add, process}], put(directory, owner, process)},
          else: {[], directory}
    end
  end

  def apply(%__MODULE__{} = directory, owner, {:remove, name}) do
    case directory.processes do
      %{^name => {^owner, _}} -> {[{:remove, name}], remove(directory, name)}
      _ -> {[], directory}
    end
  end

  def apply(%__MODULE__{} = directory, owner, :disconnect), do: gone(directory, owner)

  defp room?(%{processes: processes, bytes: bytes}, owner, process) do
    map_size(processes) < @most and bytes + :erlang.external_size(process) <= @most_bytes and
      Enum.count(processes, fn {_, {whose, _}} -> whose == owner end) < @most_each
  end

  defp put(directory, owner, process) do
    processes = Map.put(directory.processes, process.name, {owner, process})
    bytes = directory.bytes + :erlang.external_size(process)
    %{directory | processes: processes, bytes: bytes}
  end

  defp remove(directory, name) do
    {{_owner, process}, processes} = Map.pop!(directory.processes, name)
    bytes = directory.bytes - :erlang.external_size(process)
    %{directory | processes: processes, bytes: bytes}
  end

  @doc "A client has gone, and its processes with it."
  @spec gone(t(), term()) :: {[Wire.update()], t()}
  def gone(%__MODULE__{processes: processes} = directory, owner) do
    names = for {name, {^owner, _}} <- processes, do: name
    told = for name <- Enum.sort(names), do: {:remove, name}
    {told, Enum.reduce(names, directory, &remove(&2, &1))}
  end

  @doc "For people: of two processes with one name the first counts."
  @spec taken(String.t()) :: String.t()
  def taken(name),
    do:
      "another process is called #{inspect(name)}: the others see the one that came first; give each a name of its own"
end
