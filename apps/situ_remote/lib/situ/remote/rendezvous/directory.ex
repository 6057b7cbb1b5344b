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

  # One client with many names does not fill the memory.
  @most 1_000

  defstruct processes: %{}
  @type t :: %__MODULE__{}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @spec processes(t()) :: [Wire.process()]
  def processes(%__MODULE__{processes: processes}),
    do: for({_name, {_owner, process}} <- Enum.sort(processes), do: process)

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
        {[{:remove, name}, {:add, process}], put(directory, owner, process)}

      %{^name => _somebody_elses} ->
        {[], directory}

      all when map_size(all) >= @most ->
        {[], directory}

      _ ->
        {[{:add, process}], put(directory, owner, process)}
    end
  end

  def apply(%__MODULE__{} = directory, owner, {:remove, name}) do
    case directory.processes do
      %{^name => {^owner, _}} ->
        {[{:remove, name}], %{directory | processes: Map.delete(directory.processes, name)}}

      _ ->
        {[], directory}
    end
  end

  def apply(%__MODULE__{} = directory, owner, :disconnect), do: gone(directory, owner)

  defp put(directory, owner, process),
    do: %{directory | processes: Map.put(directory.processes, process.name, {owner, process})}

  @doc "A client has gone, and its processes with it."
  @spec gone(t(), term()) :: {[Wire.update()], t()}
  def gone(%__MODULE__{processes: processes} = directory, owner) do
    {its, rest} = Enum.split_with(processes, fn {_, {whose, _}} -> whose == owner end)
    told = for {name, _} <- Enum.sort(its), do: {:remove, name}
    {told, %{directory | processes: Map.new(rest)}}
  end

  @doc "For people: of two processes with one name the first counts."
  @spec taken(String.t()) :: String.t()
  def taken(name),
    do:
      "another process is called #{inspect(name)}: the others see the one that came first; give each a name of its own"
end
