defmodule Situ.Stream do
  @moduledoc """
  The handle of one output, used to connect it to inputs. It contains no messages.

    * `pipeline`: the pipeline handle (operators find their pipeline here)
    * `node`, `output`: the node's id and the output's name
    * `type`: see `Situ.Type`
    * `name`: unique within the pipeline; tools and stores find the stream by its name
  """
  @enforce_keys [:pipeline, :node, :output]
  defstruct [:pipeline, :node, :output, :name, type: :any]

  @type t :: %__MODULE__{
          pipeline: Situ.Graph.Handle.t(),
          node: pos_integer(),
          output: atom(),
          name: String.t() | nil,
          type: Situ.Type.t()
        }

  @doc "Returns the stream with another type. Nothing changes at run time; inputs check the data that arrives."
  @spec with_type(t(), Situ.Type.t()) :: t()
  def with_type(%__MODULE__{} = stream, type), do: %{stream | type: type}

  def with_type(other, _type),
    do: Situ.Argument.raise_invalid!(other, :stream, "Situ.Stream.with_type(stream, :integer)")

  defimpl Inspect do
    import Inspect.Algebra

    # The name, the type and, if it is not the only one, the output.
    def inspect(stream, opts) do
      output = if stream.output == :out, do: "", else: ".#{stream.output}"
      name = "#{stream.name || "node #{stream.node}"}#{output}"
      concat(["#Situ.Stream<", to_doc(name, opts), ", ", to_doc(stream.type, opts), ">"])
    end
  end
end
