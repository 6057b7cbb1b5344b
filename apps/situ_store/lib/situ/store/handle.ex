defmodule Situ.Store.Handle do
  @moduledoc """
  An open recording: what `Situ.Store.open/2` answers. Plain data; any process may use it, and nothing has to be closed.

    * `path`: the folder or file
    * `module`, `state`: the `Situ.Store.Reader` that reads it, and what that keeps
  """
  @enforce_keys [:path, :module, :state]
  defstruct [:path, :module, :state]
  @type t :: %__MODULE__{path: Path.t(), module: module(), state: term()}
end
