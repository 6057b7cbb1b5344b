defmodule Situ.Live.Error do
  @moduledoc """
  Why a server cannot start or a request is refused: `code` for programs, `what`, `why` and `fix` for people.

      iex> error = Situ.Live.Error.new(:port_in_use, "port 4040 is in use", fix: "choose another port")
      iex> Exception.message(error)
      "port 4040 is in use\\n  Fix: choose another port"
  """
  @enforce_keys [:code, :what]
  defexception [:code, :what, :why, :fix, meta: %{}]

  @type t :: %__MODULE__{
          code: atom(),
          what: String.t(),
          why: String.t() | nil,
          fix: String.t() | nil,
          meta: map()
        }

  @doc "Builds an error; `details` may hold `:why`, `:fix` and `:meta`."
  @spec new(atom(), String.t(), keyword()) :: t()
  def new(code, what, details \\ []), do: struct!(%__MODULE__{code: code, what: what}, details)

  @impl true
  def message(%__MODULE__{} = error) do
    [error.what, error.why && "Why: " <> error.why, error.fix && "Fix: " <> error.fix]
    |> Enum.reject(&is_nil/1)
    |> Enum.join("\n  ")
  end
end
