defmodule Situ.Store.Draft do
  @moduledoc false
  # A store made out of others. While it is written its folder is NAME.PID-N.unfinished, which nothing takes for a
  # store; only the whole gets a name. The next program that makes a store of this name sweeps away the leftovers of a
  # killed one.
  alias Situ.Error
  alias Situ.Store.{Folder, Reading, Writer}

  @doc "`work.(writer)` fills it and answers `:ok`; on an error nothing of it stays."
  @spec make({String.t(), Path.t()}, keyword(), (Writer.t() -> :ok | {:error, Error.t()})) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def make({name, root}, opts, work) do
    root = Path.expand(root)
    versioned? = Keyword.get(opts, :versioned, true)
    base = if versioned?, do: Path.join(root, name), else: root
    options = [versioned: false] ++ Keyword.take(opts, [:durability, :first_extent, :mode])
    sweep(base)

    with :ok <- free(name, root, versioned?),
         {:ok, writer} <- Writer.create(name, unique(base), options) do
      case filled(writer, work) do
        :ok -> finish(writer.path, name, root, versioned?)
        {:error, _} = error -> drop(writer, error)
      end
    end
    |> explained()
  end

  defp unique(base),
    do: "#{base}.#{System.pid()}-#{System.unique_integer([:positive])}#{Folder.unfinished()}"

  # Refuses a name that is taken before the work starts, not after it.
  defp free(_name, _root, true), do: :ok

  defp free(name, root, false) do
    with {:ok, _} <- Folder.create(name, root, false), do: :ok
  end

  defp filled(writer, work) do
    with :ok <- work.(writer), do: Writer.close(writer)
  end

  defp drop(writer, error) do
    _ = Writer.close(writer)
    _ = Folder.remove(writer.path)
    error
  end

  defp explained({:error, %{code: :disk_full} = error}) do
    why = "what was made so far is removed again; the original is as it was"
    {:error, %{error | why: why}}
  end

  defp explained(result), do: result

  defp finish(draft, name, root, versioned?) do
    with {:ok, path} <- Folder.create(name, root, versioned?),
         :ok <- move(draft, path) do
      {:ok, path}
    else
      {:error, %Error{}} = error ->
        error

      {:error, reason} ->
        {:error,
         Error.new(:io, "cannot give #{draft} its name",
           why: to_string(:file.format_error(reason)),
           fix: "rename the folder by hand; the store in it is whole"
         )}
    end
  end

  # A folder that holds other things already gets the files; the index last, with which it is a store.
  defp move(draft, path) do
    with {:error, reason} when reason in [:eexist, :enotempty] <- File.rename(draft, path) do
      names = draft |> File.ls!() |> Enum.sort() |> Enum.sort_by(&(&1 == "index.situ"))
      for name <- names, do: :ok = File.rename(Path.join(draft, name), Path.join(path, name))
      File.rmdir(draft)
    end
  end

  defp sweep(base) do
    prefix = Path.basename(base) <> "."

    for entry <- ls(Path.dirname(base)),
        String.starts_with?(entry, prefix) and Folder.unfinished?(entry),
        path = Path.join(Path.dirname(base), entry),
        {:ok, store} <- [Reading.open(path)],
        not Reading.live?(store),
        do: Folder.remove(path)
  end

  defp ls(folder) do
    case File.ls(folder) do
      {:ok, entries} -> entries
      {:error, _} -> []
    end
  end
end
