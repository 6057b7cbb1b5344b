defmodule Situ.Store.SharedWriter do
  @moduledoc false
  # A writer that several components of a pipeline write to; the last one to leave closes it.
  alias Situ.Store.Writer

  @enforce_keys [:writer, :users]
  defstruct [:writer, :users]
  @type t :: %__MODULE__{writer: Writer.t(), users: :atomics.atomics_ref()}

  @spec new(Writer.t()) :: t()
  def new(writer), do: %__MODULE__{writer: writer, users: :atomics.new(1, signed: true)}

  @doc "One more component writes to it."
  @spec join(t()) :: :ok
  def join(shared), do: :atomics.add(shared.users, 1, 1)

  @doc "A component has ended."
  @spec leave(t()) :: :ok
  def leave(shared) do
    if :atomics.sub_get(shared.users, 1, 1) == 0, do: close(shared), else: :ok
  end

  @doc "Closes the store. Nobody is left to handle a failure here, and what was committed is safe."
  @spec close(t()) :: :ok
  def close(shared) do
    _ = Writer.close(shared.writer)
    :ok
  end
end
