defmodule Situ.Studio.Bookmarks do
  @moduledoc false
  # Stores bookmarks of an item: a time or an interval, a comment, and the list that it belongs to. They are a document
  # with a log of edits (docs/adr/0190-bookmarks-are-a-document-next-to-the-recording.md), so several people can edit
  # them at the same time.
  alias Situ.EditLog.{Document, JsonFormat}
  alias Situ.Error
  alias Situ.Studio.Int64

  @type t :: %{
          id: String.t(),
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          text: String.t(),
          by: String.t(),
          list: String.t()
        }

  @most 5_000
  @most_text 2_000
  @most_name 60

  @doc """
  Returns the path of an item's bookmarks: next to a recording or a session's layers, or in the folder of the layouts
  for everything else, such as running pipelines.

      iex> alias Situ.Studio.Bookmarks
      iex> Bookmarks.document_path(%{id: "walk.0000", layers: {:recording, "/data/walk.0000"}}, "/layouts")
      "/data/walk.0000.bookmarks"
      iex> Bookmarks.document_path(%{id: "Robot arm", layers: nil}, "/layouts")
      "/layouts/bookmarks/Robot%20arm.bookmarks"
  """
  @spec document_path(
          %{:id => String.t(), :layers => term(), optional(atom()) => term()},
          Path.t()
        ) ::
          Path.t()
  def document_path(%{layers: {:recording, recording}}, _), do: recording <> ".bookmarks"
  def document_path(%{layers: {:session, store, _}}, _), do: store <> ".bookmarks"

  def document_path(%{id: id}, layouts),
    do: Path.join([layouts, "bookmarks", URI.encode(id, &URI.char_unreserved?/1) <> ".bookmarks"])

  @doc "Reads the bookmarks by time; `[]` if there are none. Error: the file is damaged."
  @spec read(Path.t()) :: {:ok, [t()]} | {:error, Error.t()}
  def read(path) do
    case Document.open(path, JsonFormat) do
      {:ok, document} -> {:ok, parse(document.content)}
      {:error, %{code: :not_found}} -> {:ok, []}
      error -> error
    end
  end

  @doc """
  Adds a bookmark, changes it, or deletes it. `changes` are untrusted: `from`, `to` (ns as text), `text`, `by` and
  `list`. Errors: `:bad_request`, `:full`, and the errors of `Situ.EditLog.Document.edit/3`.
  """
  @spec edit(Path.t(), {:add, map()} | {:change, String.t(), map()} | {:delete, String.t()}) ::
          {:ok, [t()]} | {:error, Error.t()}
  def edit(path, edit) do
    with {:ok, document} <- open_or_create(path),
         {:ok, document} <- Document.edit(document, &apply_edit(&1, edit), by: read_author(edit)),
         do: {:ok, parse(document.content)}
  end

  defp open_or_create(path) do
    with {:error, %{code: :not_found}} <- Document.open(path, JsonFormat),
         :ok <- make_folder(Path.dirname(path)),
         do: Document.put(path, JsonFormat, %{"version" => 1, "bookmarks" => %{}})
  end

  defp make_folder(folder) do
    with {:error, reason} <- File.mkdir_p(folder) do
      {:error,
       Error.new(:not_saved, "cannot save bookmarks in #{folder}",
         why: "#{:file.format_error(reason)}"
       )}
    end
  end

  defp read_author({_, %{"by" => by}}) when is_binary(by) and by != "", do: cut(by, @most_name)
  defp read_author(_), do: nil

  defp apply_edit(content, {:add, changes}) do
    all = bookmarks_of(content)

    cond do
      map_size(all) >= @most ->
        {:error,
         Error.new(:full, "a recording has at most #{@most} bookmarks", fix: "delete some")}

      fields = valid_fields(changes) ->
        if is_map_key(fields, "from"),
          do: {:ok, put_bookmark(content, new_id(all), fields)},
          else: invalid()

      true ->
        invalid()
    end
  end

  defp apply_edit(content, {:change, id, changes}) do
    case {bookmarks_of(content)[id], valid_fields(changes)} do
      {%{} = old, %{} = fields} ->
        {:ok, put_bookmark(content, id, Map.merge(old, Map.delete(fields, "by")))}

      {nil, _} ->
        {:error, Error.new(:gone, "somebody has deleted this bookmark")}

      _ ->
        invalid()
    end
  end

  defp apply_edit(content, {:delete, id}),
    do: {:ok, Map.put(content, "bookmarks", Map.delete(bookmarks_of(content), id))}

  defp put_bookmark(content, id, fields),
    do: Map.put(content, "bookmarks", Map.put(bookmarks_of(content), id, fields))

  defp bookmarks_of(%{"bookmarks" => %{} = all}), do: all
  defp bookmarks_of(_), do: %{}

  defp new_id(taken) do
    id = 6 |> :crypto.strong_rand_bytes() |> Base.encode16(case: :lower)
    if is_map_key(taken, id), do: new_id(taken), else: id
  end

  # Returns the fields that may be stored, or `nil` if any is invalid. Times stay texts, because other programs
  # do not keep integers of this size exact.
  defp valid_fields(changes) do
    texts =
      for {key, most} <- [{"text", @most_text}, {"by", @most_name}, {"list", @most_name}],
          text = changes[key],
          do: {key, text, most}

    times = Map.take(changes, ["from", "to"])

    if Enum.all?(texts, fn {_, text, _} -> is_binary(text) and String.valid?(text) end) and
         valid_times?(times) do
      for {key, text, most} <- texts, into: times, do: {key, cut(text, most)}
    end
  end

  defp valid_times?(times) when times == %{}, do: true

  defp valid_times?(%{"from" => from, "to" => to}) do
    with {:ok, from} <- Int64.parse(from),
         {:ok, to} <- Int64.parse(to),
         do: from <= to,
         else: (_ -> false)
  end

  defp valid_times?(_), do: false

  defp cut(text, most), do: text |> String.trim() |> String.slice(0, most)
  defp invalid, do: {:error, Error.new(:bad_request, "invalid bookmark")}

  # Entries that cannot be read are left out.
  defp parse(%{"bookmarks" => %{} = all}) do
    for {id, %{"from" => from, "to" => to} = fields} <- all,
        {:ok, from} <- [Int64.parse(from)],
        {:ok, to} <- [Int64.parse(to)] do
      [text, by, list] = for key <- ["text", "by", "list"], do: text_of(fields[key])
      %{id: id, from: from, to: to, text: text, by: by, list: list}
    end
    |> Enum.sort_by(&{&1.from, &1.to, &1.id})
  end

  defp parse(_), do: []

  defp text_of(text), do: if(is_binary(text), do: text, else: "")
end
