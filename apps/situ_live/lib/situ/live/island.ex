defmodule Situ.Live.Island do
  @moduledoc false
  # A part of a page that the browser patches separately: see `Situ.Live.Component.island/1`.
  @enforce_keys [:rendered]
  defstruct [:rendered]

  @type t :: %__MODULE__{rendered: Situ.Live.Rendered.t()}
end
