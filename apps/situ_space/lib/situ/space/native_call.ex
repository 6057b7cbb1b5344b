defmodule Situ.Space.NativeCall do
  @moduledoc false
  # The only entry to the native kernels. It converts their failures and arguments of the wrong type to Situ.Error.
  #
  # Shapes are plain data in `situ_types`, so a bridge that sends a pose does not depend on these
  # kernels. All kernels search for neighbors within a fixed radius. They use a grid of cubes with
  # that edge, where 27 cubes suffice; a k-d tree would need more code and be slower. They run on
  # dirty schedulers because the cost of a cloud depends on its content.
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
