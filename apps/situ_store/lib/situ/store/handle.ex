defmodule Situ.Store.Handle do
  @moduledoc """
  An open recording, as returned by `Situ.Store.open/2`. A handle is plain data: any process may use it, and it does not
  need to be closed.

    * `path`: the folder or file
    * `module`, `state`: the `Situ.Store.Reader` that reads it, and the state of that reader
  """
  @enforce_keys [:path, :module, :state]
  defstruct [:path, :module, :state]
  @type t :: %__MODULE__{path: Path.t(), module: module(), state: term()}
end
