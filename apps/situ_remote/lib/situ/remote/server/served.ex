defmodule Situ.Remote.Server.Served do
  @moduledoc false
  # Finds the recording of a server by the name that a client sends.
  alias Situ.Error

  @type served :: %{String.t() => {module(), term()}}

  @doc "Without a name, where there is but one; a name with its version; errors: `:no_recording`."
  @spec find(served(), String.t()) :: {:ok, {module(), term()}} | {:error, Error.t()}
  def find(served, "") when map_size(served) == 1, do: {:ok, served |> Map.values() |> hd()}

  def find(served, name) do
    with :error <- Map.fetch(served, name), :error <- version(served, name) do
      {:error,
       Error.new(:no_recording, "nothing is served under the name #{inspect(name)}",
         fix: "served: #{served |> Map.keys() |> Enum.join(", ")}"
       )}
    end
  end

  # One version of a recording that is served.
  defp version(served, name) do
    with [_, name, version] <- Regex.run(~r/\A(.+)\.(\d{4,9})\z/s, name),
         {:ok, {module, spec}} <- Map.fetch(served, name),
         {:ok, spec} <- module.version(spec, String.to_integer(version)) do
      {:ok, {module, spec}}
    else
      _ -> :error
    end
  end
end
