defmodule Situ.Dataset.Version do
  @moduledoc false
  # A store in the making has a folder that nothing takes for a store; whole, it becomes the next version
  # ROOT/NAME.NNNN.
  alias Situ.{Error, Store}

  @suffix ".unfinished"

  @doc "A folder for a store that is to become a version of `ROOT/NAME`."
  @spec draft(Path.t()) :: Path.t()
  def draft(path), do: "#{path}.#{System.pid()}-#{System.unique_integer([:positive])}#{@suffix}"

  @doc "Gives a whole store its name; a number that another process took meanwhile is followed by the next."
  @spec publish(Path.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def publish(draft, path) do
    folder = "#{path}.#{path |> next() |> Integer.to_string() |> String.pad_leading(4, "0")}"

    case File.rename(draft, folder) do
      :ok ->
        {:ok, folder}

      {:error, reason} when reason in [:eexist, :enotempty] ->
        publish(draft, path)

      {:error, reason} ->
        {:error,
         Error.new(:not_saved, "cannot give #{draft} its name",
           why: to_string(:file.format_error(reason)),
           fix: "rename the folder to #{folder}; the store in it is whole"
         )}
    end
  end

  @doc "Deletes a draft that became nothing; anything else is left alone."
  @spec discard(Path.t()) :: :ok
  def discard(path) do
    if String.ends_with?(path, @suffix), do: File.rm_rf(path)
    :ok
  end

  defp next(path) do
    case Store.newest(Path.basename(path), Path.dirname(path)) do
      nil -> 0
      newest -> newest |> String.split(".") |> List.last() |> String.to_integer() |> Kernel.+(1)
    end
  end
end
