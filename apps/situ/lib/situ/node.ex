defmodule Situ.Node do
  @moduledoc """
  A component in a pipeline. `Situ.Pipeline.add/3` returns it, and streams are connected to it.

    * `pipeline`: the handle it belongs to
    * `id`: 1, 2, 3 ... in the order of construction
    * `path`: its full, unique name (`"Lobby.Mouth.Crop"`)
    * `module`: the component's module, or `:operator`
    * `inputs`, `outputs`: keyword lists of name and type

      iex> defmodule Nothing do
      ...>   use Situ.Component
      ...>   def handle_start(context, state), do: {[{:complete, context.start_time}], state}
      ...> end
      iex> {:ok, report} = Situ.Pipeline.run(fn p -> Situ.Pipeline.add(p, Nothing) end)
      iex> {report.result.path, report.result.inputs}
      {"Nothing", []}
  """
  @enforce_keys [:pipeline, :id, :path, :module, :inputs, :outputs]
  defstruct [:pipeline, :id, :path, :module, :inputs, :outputs]

  @type t :: %__MODULE__{
          pipeline: Situ.Graph.Handle.t(),
          id: pos_integer(),
          path: String.t(),
          module: module() | :operator,
          inputs: keyword(),
          outputs: keyword()
        }

  @doc "Returns the stream of an output. Raises `Situ.Error` (`:unknown_output`) if the output does not exist."
  @spec output(t(), atom()) :: Situ.Stream.t()
  def output(%__MODULE__{} = node, name) do
    case Keyword.fetch(node.outputs, name) do
      {:ok, type} ->
        %Situ.Stream{pipeline: node.pipeline, node: node.id, output: name, type: type}
        |> Map.put(:name, Situ.Graph.StreamNames.default_name(node.path, name, node.outputs))

      :error ->
        raise Situ.Graph.unknown_port(:output, node, name)
    end
  end

  def output(other, _name),
    do: Situ.Argument.raise_invalid!(other, :node, "Situ.Node.output(node, :out)")

  @doc "Returns the stream of the only output, or a map from name to stream for several outputs (`%{}` for none)."
  @spec streams(t()) :: Situ.Stream.t() | %{atom() => Situ.Stream.t()}
  def streams(%__MODULE__{outputs: [{name, _}]} = node), do: output(node, name)

  def streams(%__MODULE__{outputs: outputs} = node),
    do: Map.new(outputs, fn {name, _} -> {name, output(node, name)} end)

  def streams(other), do: Situ.Argument.raise_invalid!(other, :node, "Situ.Node.streams(node)")

  defimpl Inspect do
    # The path, the module, and the ports with their types.
    def inspect(node, _opts) do
      module = if node.module == :operator, do: "operator", else: Kernel.inspect(node.module)
      ports = describe_ports("in", node.inputs) ++ describe_ports("out", node.outputs)
      "#Situ.Node<#{Enum.join([Kernel.inspect(node.path), module | ports], ", ")}>"
    end

    defp describe_ports(_kind, []), do: []

    defp describe_ports(kind, ports) do
      ports = for {name, type} <- ports, do: "#{name} #{Situ.Type.to_string(type)}"
      ["#{kind}: #{Enum.join(ports, ", ")}"]
    end
  end
end
