defmodule Situ.Graph.Handle do
  @moduledoc false
  # The handle of a pipeline under construction: the process that owns the graph, a unique reference to the graph, and
  # the scope in which components are added (the path of the composite being built, or `nil`).
  #
  # `Situ.Pipeline.new/1` creates a handle, `build/2` receives it, and every stream and node contains it.

  @enforce_keys [:pid, :ref]
  defstruct [:pid, :ref, :scope]

  @type t :: %__MODULE__{pid: pid(), ref: reference(), scope: String.t() | nil}

  defimpl Inspect do
    import Inspect.Algebra

    def inspect(handle, opts) do
      scope = if handle.scope, do: concat([", in ", to_doc(handle.scope, opts)]), else: empty()
      concat(["#Situ.Pipeline<", to_doc(handle.pid, opts), scope, ">"])
    end
  end
end
