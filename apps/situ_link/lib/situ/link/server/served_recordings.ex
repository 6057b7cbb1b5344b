defmodule Situ.Link.Server.ServedRecordings do
  @moduledoc false
  # Finds a served recording by the name that a client sends.
  alias Situ.Error
  alias Situ.Link.Server.RecordingReader

  @type served :: %{String.t() => RecordingReader.spec()}

  @doc """
  Fetches a recording by its name, with or without a version. The name may be empty if the server has only one.

  Errors: `:no_recording`.
  """
  @spec fetch_recording(served(), String.t()) ::
          {:ok, RecordingReader.spec()} | {:error, Error.t()}
  def fetch_recording(served, "") when map_size(served) == 1,
    do: {:ok, served |> Map.values() |> hd()}

  def fetch_recording(served, name) do
    with :error <- Map.fetch(served, name), :error <- fetch_version(served, name) do
      {:error,
       Error.new(:no_recording, "the server has no recording named #{inspect(name)}",
         fix: "use one of these names: #{served |> Map.keys() |> Enum.join(", ")}"
       )}
    end
  end

  # The name may end with a version of a served recording.
  defp fetch_version(served, name) do
    with [_, name, version] <- Regex.run(~r/\A(.+)\.(\d{4,9})\z/s, name),
         {:ok, spec} <- Map.fetch(served, name),
         {:ok, spec} <- RecordingReader.select_version(spec, String.to_integer(version)) do
      {:ok, spec}
    else
      _ -> :error
    end
  end
end
