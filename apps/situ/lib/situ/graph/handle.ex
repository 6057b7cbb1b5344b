defmodule Situ.Graph.Handle do
  @moduledoc """
  The handle of a pipeline under construction: the process that owns the graph, a reference unique to the graph, and
  the scope (the path of the composite being built, or `nil`) below which components are added.

  `Situ.Pipeline.new/1` makes one, `build/2` gets one, and every stream and node carries one.
  """
  @enforce_keys [:pid, :ref]
  defstruct [:pid, :ref, :scope]

  @type t :: %__MODULE__{pid: pid(), ref: reference(), scope: String.t() | nil}
end
