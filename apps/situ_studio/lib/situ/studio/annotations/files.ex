defmodule Situ.Studio.Annotations.Files do
  @moduledoc false
  # Names the files of a recording's annotations. Each stream has its own store next to the
  # recording, so that two people who annotate the recording at the same time can save
  # independently.

  @doc """
  Returns the path of the store of one stream of annotations, without its version.

      iex> Situ.Studio.Annotations.Files.store_path("/study/lobby.0000", "Speech.Ada")
      "/study/lobby.0000-annotation-Speech%2EAda"
  """
  @spec store_path(Path.t(), String.t()) :: Path.t()
  def store_path(recording, stream), do: path_prefix(recording) <> escape_name(stream)

  defp path_prefix(recording), do: recording <> "-annotation-"

  # A dot would be mistaken for the start of a version suffix.
  defp escape_name(stream),
    do: stream |> URI.encode(&URI.char_unreserved?/1) |> String.replace(".", "%2E")

  @doc """
  Returns whether a path names a store of annotations, next to a recording or of a session.

      iex> for path <- ~w(a.0000 a.0000-annotation-Speech.0001 p1/annotations.0002 p1/annotations),
      ...>   do: Situ.Studio.Annotations.Files.layer_store?(path)
      [false, true, true, true]
  """
  @spec layer_store?(Path.t()) :: boolean()
  def layer_store?(path),
    do: Path.basename(path) =~ ~r/-annotation-|\Aannotations(\.\d{4,})?\z/

  @doc "Returns the stores of a recording's annotations, without their versions."
  @spec list_stores(Path.t()) :: [Path.t()]
  def list_stores(recording) do
    start = Path.basename(path_prefix(recording))
    folder = Path.dirname(recording)

    with {:ok, names} <- File.ls(folder) do
      for name <- names,
          String.starts_with?(name, start),
          path = Path.join(folder, Path.rootname(name)),
          uniq: true,
          do: path
    else
      _ -> []
    end
  end
end
