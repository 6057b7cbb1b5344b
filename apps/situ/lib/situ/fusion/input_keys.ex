defmodule Situ.Fusion.InputKeys do
  @moduledoc false
  # Keys of inputs that can be added and removed. Checks that new keys are unique and requested keys exist.
  alias Situ.Error

  @doc "Checks that `key` is not among the keys in use."
  @spec check_free([term()], term()) :: :ok | {:error, Error.t()}
  def check_free(taken, key) do
    if key in taken do
      {:error,
       Error.new(:duplicate_input, "an input #{inspect(key)} already exists",
         fix: "use a different key, or remove the existing input first"
       )}
    else
      :ok
    end
  end

  @doc "Returns the error for a key that does not exist."
  @spec unknown_key_error([term()], term()) :: {:error, Error.t()}
  def unknown_key_error(known, key) do
    {:error,
     Error.new(:unknown_input, "input #{inspect(key)} does not exist",
       fix: "existing inputs: " <> Enum.map_join(known, ", ", &inspect/1)
     )}
  end
end
