defmodule Situ.Dataset.DatasetDocument do
  @moduledoc false
  # A dataset file as a document with a log of edits. The content consists of the fields of a dataset, so an edit of one
  # session converts only this session to JSON.
  @behaviour Situ.EditLog.Document
  alias Situ.Dataset.{FileFormat, Session}
  alias Situ.EditLog.{Changes, Listing, Mark}

  @head [:name, :tags, :metadata, :extra]

  @impl true
  def parse(text, path) do
    with {:ok, fields} <- FileFormat.parse(text, path) do
      {mark, extra} = Map.pop(fields.extra, "edits")
      {:ok, %{fields | extra: extra}, Mark.parse(mark)}
    end
  end

  @impl true
  def encode(fields, path, mark), do: FileFormat.encode(fields, path, mark)

  @impl true
  def to_json(fields, path),
    do:
      Map.put(
        head_json(fields),
        "sessions",
        Enum.map(fields.sessions, &FileFormat.session_json(&1, path))
      )

  defp head_json(fields) do
    head = %{"name" => fields.name, "tags" => fields.tags, "metadata" => fields.metadata}
    fields.extra |> Map.merge(head) |> normalize()
  end

  defp normalize(value) do
    {:ok, value} = value |> Situ.JSON.encode() |> Situ.JSON.decode()
    value
  end

  @impl true
  def from_json(json, path) do
    case FileFormat.parse(Situ.JSON.encode(json), path) do
      {:ok, fields} -> {:ok, fields}
      {:error, _} -> :error
    end
  end

  @impl true
  def diff(before, later, path) do
    diff_head(Map.take(before, @head), Map.take(later, @head)) ++
      Listing.diff(
        before.sessions,
        later.sessions,
        ["sessions"],
        &Changes.diff/3,
        &FileFormat.session_json(&1, path)
      )
  end

  defp diff_head(same, same), do: []
  defp diff_head(before, later), do: Changes.diff(head_json(before), head_json(later))

  @impl true
  def apply_change(fields, ["order", ["sessions"], _, _] = change, _path),
    do:
      put_sessions(fields, Listing.apply_change(fields.sessions, List.replace_at(change, 1, [])))

  def apply_change(fields, [kind, ["sessions", name | rest], a, b], path),
    do: put_sessions(fields, change_sessions(fields.sessions, [kind, [name | rest], a, b], path))

  def apply_change(fields, change, _path) do
    with {:ok, head} <- Changes.apply_change(head_json(fields), change) do
      {known, extra} = Map.split(head, ["name", "tags", "metadata"])
      put_head(fields, known, extra)
    end
  end

  defp put_head(fields, %{"name" => name, "tags" => tags, "metadata" => %{} = metadata}, extra)
       when is_binary(name) and is_list(tags),
       do: {:ok, %{fields | name: name, tags: tags, metadata: metadata, extra: extra}}

  defp put_head(_fields, _known, _extra), do: :conflict

  defp put_sessions(fields, {:ok, sessions}), do: {:ok, %{fields | sessions: sessions}}
  defp put_sessions(_fields, :conflict), do: :conflict

  defp change_sessions(sessions, ["rename", [name], _from, to], _path),
    do: Listing.rename_item(sessions, name, {to, &%{&1 | name: to}})

  defp change_sessions(sessions, [kind, [name], json, index], path)
       when kind in ["add", "remove"] do
    case {kind, Listing.fetch_item(sessions, name), FileFormat.parse_session(json, path)} do
      {"add", :error, {:ok, session}} ->
        {:ok, Listing.insert_item(sessions, session, index)}

      {"add", {:ok, current}, _} ->
        keep_if(same_session?(current, json, path), sessions)

      {"remove", :error, _} ->
        {:ok, sessions}

      {"remove", {:ok, current}, _} ->
        remove_if(same_session?(current, json, path), sessions, current)

      _ ->
        :conflict
    end
  end

  defp change_sessions(sessions, [kind, [name | rest], a, b], path),
    do: Listing.update_item(sessions, name, &change_session(&1, [kind, rest, a, b], path))

  defp change_session(%Session{} = session, change, path) do
    with {:ok, json} <- Changes.apply_change(FileFormat.session_json(session, path), change),
         {:ok, session} <- FileFormat.parse_session(json, path) do
      {:ok, session}
    else
      _ -> :conflict
    end
  end

  defp same_session?(session, json, path), do: FileFormat.session_json(session, path) == json
  defp keep_if(true, sessions), do: {:ok, sessions}
  defp keep_if(false, _sessions), do: :conflict
  defp remove_if(true, sessions, session), do: {:ok, List.delete(sessions, session)}
  defp remove_if(false, _sessions, _session), do: :conflict
end
