defmodule Situ.Node do
  @moduledoc """
  A component placed in a pipeline: what `Situ.Pipeline.add/3` returns and what streams are connected to.

    * `pipeline`: the handle it belongs to
    * `id`: 1, 2, 3 ... in the order of construction
    * `path`: its full, unique name (`"Lobby.Mouth.Crop"`)
    * `module`: the component's module, or `:operator`
    * `inputs`, `outputs`: keyword lists of name and type

      iex> {:ok, report} = Situ.Pipeline.run(fn p -> Situ.Pipeline.add(p, Situ.Component.Empty) end)
      iex> report.result.path
      "Empty"
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

  @doc "The stream of one output. Raises `Situ.Error` (`:unknown_output`) when there is none of this name."
  @spec output(t(), atom()) :: Situ.Stream.t()
  def output(%__MODULE__{} = node, name) do
    case Keyword.fetch(node.outputs, name) do
      {:ok, type} ->
        %Situ.Stream{pipeline: node.pipeline, node: node.id, output: name, type: type}
        |> Map.put(:name, Situ.Graph.stream_name(node.path, name, node.outputs))

      :error ->
        raise Situ.Graph.unknown_port(:output, node, name)
    end
  end

  def output(other, _name),
    do: Situ.Argument.refuse!(other, :node, "Situ.Node.output(node, :out)")

  @doc "The only output's stream, or a map of name and stream when there are several (`%{}` for none)."
  @spec streams(t()) :: Situ.Stream.t() | %{atom() => Situ.Stream.t()}
  def streams(%__MODULE__{outputs: [{name, _}]} = node), do: output(node, name)

  def streams(%__MODULE__{outputs: outputs} = node),
    do: Map.new(outputs, fn {name, _} -> {name, output(node, name)} end)

  def streams(other), do: Situ.Argument.refuse!(other, :node, "Situ.Node.streams(node)")
end
