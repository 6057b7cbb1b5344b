defmodule Situ.EditLog.Replay do
  @moduledoc false
  # Computes the states of a JSON document from its log, and merges a file that somebody has edited.
  alias Situ.{EditLog, Error}
  alias Situ.EditLog.{Changes, Entry}

  @doc "Returns the changes of entries, in order."
  @spec list_changes([Entry.t()]) :: [Changes.change()]
  def list_changes(entries), do: Enum.flat_map(entries, &entry_changes/1)

  defp entry_changes(%{do: %{"changes" => changes}}) when is_list(changes), do: changes
  defp entry_changes(_entry), do: []

  @doc "Returns the document after the first entries of a log. Error: `:bad_log`."
  @spec apply_entries(EditLog.t(), [Entry.t()]) :: {:ok, map()} | {:error, Error.t()}
  def apply_entries(log, entries) do
    with {:ok, base} <- EditLog.read_base(log) do
      case Changes.apply_all(base, list_changes(entries)) do
        {:ok, json} -> {:ok, json}
        {:conflict, _} -> {:error, EditLog.damaged_error(log, log.offset)}
      end
    end
  end

  @doc """
  Merges a file, `{json, mark, digest}`, with the log: the edits of the file apply to the version that its mark names,
  and replace other changes of the same places. Returns the log, the document without the edits of the file, and the
  merged document.
  """
  @spec merge_file(Path.t(), {map(), map() | nil, String.t()}) ::
          {:ok, EditLog.t(), map(), map()} | {:error, Error.t()}
  def merge_file(path, {file, mark, digest}) do
    with {:ok, log, entries} <- EditLog.read_all(path),
         {:ok, now} <- apply_entries(log, entries),
         {:ok, base} <- find_base(log, {entries, now}, mark) do
      edits = if adopted?(entries, digest), do: [], else: Changes.diff(base, file)
      {:ok, log, now, Enum.reduce(edits, now, &Changes.force_change(&2, &1))}
    end
  end

  # A program that took over the edits of the file was killed before it wrote the file.
  defp adopted?(entries, digest) do
    {later, rest} = entries |> Enum.reverse() |> Enum.split_while(&(&1.kind != "outside"))

    case rest do
      [%{of: ^digest, n: n} | _] -> not Enum.any?(later, &((&1.file || 0) >= n))
      _ -> false
    end
  end

  defp find_base(%{id: id} = log, {entries, now}, %{"log" => id, "version" => version}) do
    if version <= log.n,
      do: apply_entries(log, Enum.take(entries, version)),
      else: {:ok, now}
  end

  defp find_base(_log, {_entries, now}, _mark), do: {:ok, now}
end
