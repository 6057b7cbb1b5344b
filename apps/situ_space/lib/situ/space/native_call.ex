defmodule Situ.Space.NativeCall do
  @moduledoc false
  # The only entry to the native kernels. It converts their failures and arguments of the wrong type to Situ.Error.
  alias Situ.Error
  alias Situ.Space.Native

  @doc "Calls a function of `Situ.Space.Native`."
  @spec call_native(atom(), [term()]) :: {:ok, term()} | {:error, Error.t()}
  def call_native(function, arguments) do
    case apply(Native, function, arguments) do
      {:ok, value} -> {:ok, value}
      {:error, code, what} -> {:error, Error.new(code, what)}
    end
  rescue
    ArgumentError ->
      {:error,
       Error.new(
         :bad_option,
         "invalid arguments for #{function}: #{inspect(arguments, limit: 5)}"
       )}
  end
end
