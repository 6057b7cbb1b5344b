defmodule Situ.Space.FileParser do
  @moduledoc false
  # Reads a whole file of limited size and parses it. Errors contain the path of the file.
  alias Situ.Error

  @doc """
  Calls `parse` with the bytes of a file and returns its result. Errors are `:no_file`, `:too_large` for a file of more
  than `most` bytes, and the errors of `parse`.
  """
  @spec read_and_parse(Path.t(), pos_integer(), (binary() -> tuple())) :: tuple()
  def read_and_parse(path, most, parse) do
    with {:ok, %{size: size}} when size <= most <- File.stat(path),
         {:ok, bytes} <- File.read(path) do
      with {:error, %Error{} = error} <- parse.(bytes),
           do: {:error, %{error | what: "#{path}: #{error.what}"}}
    else
      {:ok, %{size: size}} ->
        {:error,
         Error.new(:too_large, "#{path} has #{size} bytes, which is too large",
           why: "files of this type are read into memory and limited in size",
           fix: "split the file into smaller ones"
         )}

      {:error, reason} ->
        {:error,
         Error.new(:no_file, "#{path} cannot be read", why: to_string(:file.format_error(reason)))}
    end
  end
end
