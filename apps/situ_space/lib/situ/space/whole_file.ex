defmodule Situ.Space.WholeFile do
  @moduledoc false
  # Files that are read as a whole: opened, bounded, parsed; what is wrong with one names it.
  alias Situ.Error

  @doc "The answer of `parse` to the bytes of a file of at most so many. Errors: its own, `:too_large`, `:no_file`."
  @spec read(Path.t(), pos_integer(), (binary() -> tuple())) :: tuple()
  def read(path, most, parse) do
    with {:ok, %{size: size}} when size <= most <- File.stat(path),
         {:ok, bytes} <- File.read(path) do
      with {:error, %Error{} = error} <- parse.(bytes),
           do: {:error, %{error | what: "#{path}: #{error.what}"}}
    else
      {:ok, %{size: size}} ->
        {:error,
         Error.new(:too_large, "#{path} has #{size} bytes",
           why: "such files are read as a whole",
           fix: "cut it"
         )}

      {:error, reason} ->
        {:error,
         Error.new(:no_file, "#{path} cannot be read", why: to_string(:file.format_error(reason)))}
    end
  end
end
