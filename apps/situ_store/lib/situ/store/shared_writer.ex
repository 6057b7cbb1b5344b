defmodule Situ.Store.SharedWriter do
  @moduledoc false
  # A writer that several components of a pipeline share. The last component to leave closes it.
  alias Situ.Store.{OpenRecordings, Writer}

  @enforce_keys [:writer, :users]
  defstruct [:writer, :users]
  @type t :: %__MODULE__{writer: Writer.t(), users: :atomics.atomics_ref()}

  @spec new(Writer.t()) :: t()
  def new(writer) do
    OpenRecordings.add_writer(writer)
    %__MODULE__{writer: writer, users: :atomics.new(1, signed: true)}
  end

  @doc "Adds a component that writes to the store."
  @spec add_user(t()) :: :ok
  def add_user(shared), do: :atomics.add(shared.users, 1, 1)

  @doc "Removes a component that has ended, and closes the store after the last one."
  @spec remove_user(t()) :: :ok
  def remove_user(shared) do
    if :atomics.sub_get(shared.users, 1, 1) == 0, do: close(shared), else: :ok
  end

  @doc "Closes the store. Failures are ignored because no component is left to handle them; committed data is safe."
  @spec close(t()) :: :ok
  def close(shared) do
    OpenRecordings.remove_writer(shared.writer)
    _ = Writer.close(shared.writer)
    :ok
  end
end
