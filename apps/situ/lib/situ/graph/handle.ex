defmodule Situ.Graph.Handle do
  @moduledoc """
  What names a pipeline to those who build on it: the process that owns the graph, a reference that tells one graph from
  another, and the scope (the path of the composite being built, or `nil`) below which components are added.

  `Situ.Pipeline.new/1` makes one, `build/2` is given one, and every stream and node carries one.
  """
  @enforce_keys [:pid, :ref]
  defstruct [:pid, :ref, :scope]

  @type t :: %__MODULE__{pid: pid(), ref: reference(), scope: String.t() | nil}
end
