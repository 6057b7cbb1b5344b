defmodule Situ.Fusion.Keys do
  @moduledoc false
  # Keys of inputs that come and go: no two alike, and a key that is asked for is there.
  alias Situ.Error

  @doc "`key` is not among those taken."
  @spec free([term()], term()) :: :ok | {:error, Error.t()}
  def free(taken, key) do
    if key in taken do
      {:error,
       Error.new(:duplicate_input, "there is already an input #{inspect(key)}",
         fix: "give it another key, or remove the other one first"
       )}
    else
      :ok
    end
  end

  @doc "The error of a key that is not there."
  @spec unknown([term()], term()) :: {:error, Error.t()}
  def unknown(known, key) do
    {:error,
     Error.new(:unknown_input, "there is no input #{inspect(key)}",
       fix: "there are: " <> Enum.map_join(known, ", ", &inspect/1)
     )}
  end
end
