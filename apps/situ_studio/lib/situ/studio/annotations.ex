defmodule Situ.Studio.Annotations do
  @moduledoc false
  # Edits a layer of annotations on behalf of a page: opens it, returns its state for display, and
  # applies the page's requests.
  #
  # Layers are in separate stores (`Situ.Studio.Annotations.Layers`); recordings are never
  # modified. Every edit is written to disk before it is acknowledged
  # (`Situ.Annotation.Editor`), so a crash of the page or the server loses nothing.
  alias Situ.{Annotation, Error}
  alias Situ.Annotation.{Edit, Editor, Layer, Schema}
  alias Situ.Studio.Annotations.{Editors, Proposals, Request, SchemaForm, TierList}
  alias Situ.Studio.Catalog

  @most 20_000

  @doc """
  Parses a schema of one attribute from text: one value per line, followed by its key and its
  color.

      iex> {:ok, schema} = Situ.Studio.Annotations.parse_schema("Speech", "speaks 1 #1f77b4\\nlaughs 2")
      iex> for v <- hd(schema.attributes).values, do: {v.value, v.key, v.fill}
      [{"speaks", "1", "#1f77b4"}, {"laughs", "2", nil}]
      iex> {:error, error} = Situ.Studio.Annotations.parse_schema("Speech", "a 1\\nb 1")
      iex> error.code
      :bad_schema
  """
  @spec parse_schema(String.t(), String.t()) :: {:ok, Schema.t()} | {:error, Error.t()}
  def parse_schema(name, text) do
    values =
      for line <- String.split(text, ~r/[\n,;]/, trim: true),
          String.trim(line) != "",
          do: parse_value(line)

    attribute =
      if values == [],
        do: %{"name" => name, "kind" => "text"},
        else: %{"name" => name, "kind" => "finite", "values" => values}

    Schema.parse(%{"name" => name, "attributes" => [attribute]})
  end

  defp parse_value(line) do
    {marks, words} =
      line |> String.split() |> Enum.reverse() |> Enum.split_while(&(parse_mark(&1) != nil))

    # A line that contains only a key or a color still needs a value: the first word is the value.
    {marks, words} =
      if words == [], do: {Enum.drop(marks, -1), [List.last(marks)]}, else: {marks, words}

    for mark <- marks,
        into: %{"value" => words |> Enum.reverse() |> Enum.join(" ")},
        do: parse_mark(mark)
  end

  defp parse_mark("#" <> _ = fill), do: {"fill", fill}
  defp parse_mark(<<_::utf8>> = key), do: {"key", key}
  defp parse_mark(_), do: nil

  @doc """
  Builds the schema of boxes or points on images: positions are numbers in pixels, and each annotation is a key frame.
  """
  @spec build_spatial_schema(String.t(), :box | :point) :: Schema.t()
  def build_spatial_schema(name, kind) do
    names = if kind == :box, do: ~w(x y width height), else: ~w(x y)
    numbers = for n <- names, do: %{"name" => n, "kind" => "number"}
    {:ok, schema} = Schema.parse(%{"name" => name, "attributes" => numbers})
    schema
  end

  @doc """
  Returns the editor of a stream of annotations in the store at `store`, and starts it on the first call. `schema`
  creates a missing stream.
  """
  @spec open_editor(Catalog.id(), Path.t(), String.t(), Schema.t() | nil) ::
          {:ok, pid()} | {:error, Error.t()}
  def open_editor(studio, store, stream, schema) do
    name = Editors.editor_name(studio, store, stream)
    opts = [path: store, stream: stream, schema: schema, name: name, save_on_leave: true]
    child = %{id: Editor, start: {Editor, :start_link, [opts]}, restart: :temporary}

    case DynamicSupervisor.start_child(Catalog.watch_supervisor(studio), child) do
      {:ok, pid} ->
        save_new_schema(pid, schema)

      {:error, {:already_started, pid}} ->
        {:ok, pid}

      {:error, %Error{} = error} ->
        {:error, error}

      {:error, reason} ->
        {:error, Error.new(:not_opened, "the annotations cannot be opened: #{inspect(reason)}")}
    end
  end

  # The journal does not contain the schema, so a new stream is saved immediately.
  defp save_new_schema(pid, nil), do: {:ok, pid}

  defp save_new_schema(pid, _schema) do
    with {:ok, _} <- Editor.save(pid), do: {:ok, pid}
  end

  @doc "Returns everything that the page needs to draw the annotations of a stream."
  @spec page_state(pid(), String.t()) :: map()
  def page_state(editor, stream) do
    layer = Editor.current_layer(editor)
    status = Editor.status(editor)

    %{
      stream: stream,
      attributes: Enum.map(layer.schema.attributes, &attribute_to_map/1),
      tracks: Layer.track_names(layer),
      tiers: TierList.list_tiers(layer),
      items: layer |> Layer.annotations() |> Enum.take(@most) |> Enum.map(&annotation_to_map/1),
      review: Layer.review_progress(layer),
      undo: status.undo,
      redo: status.redo,
      unsaved: status.unsaved?,
      recovered: status.recovered,
      version: status.version,
      shadowed: status.shadowed && Path.basename(status.shadowed)
    }
  end

  defp attribute_to_map(a) do
    values = for v <- a.values, do: Map.take(v, [:value, :fill, :key])
    %{name: a.name, kind: a.kind, default: a.default, fill: a.fill, values: values}
  end

  @doc "Converts an annotation for the page. Times are strings because JavaScript numbers are not exact enough."
  @spec annotation_to_map(Annotation.t()) :: map()
  def annotation_to_map(a) do
    %{
      id: a.id,
      from: Integer.to_string(a.from),
      to: Integer.to_string(a.to),
      track: a.track,
      values: a.values,
      proposed: a.proposed?,
      confidence: a.confidence,
      note: a.note,
      by: a.by
    }
  end

  @doc "Applies an edit from the page; an error names the rule that the edit would break."
  @spec apply_edit(pid(), map()) :: :ok | {:error, Error.t()}
  def apply_edit(editor, %{"do" => "undo"}), do: edit_result(Editor.undo(editor))
  def apply_edit(editor, %{"do" => "redo"}), do: edit_result(Editor.redo(editor))
  def apply_edit(editor, %{"do" => "save"}), do: edit_result(Editor.save(editor))

  def apply_edit(editor, %{"do" => name} = params),
    do:
      edit_result(
        Editor.edit(editor, &Request.apply_change(name, &1, params), edit_options(params))
      )

  def apply_edit(_, _), do: invalid_edit()

  # The person is for the history. The version is the version on the page.
  defp edit_options(params) do
    by = params["by"]
    version = params["version"]

    [
      by:
        if(is_binary(by) and String.trim(by) != "", do: by |> String.trim() |> String.slice(0, 60)),
      version: if(is_integer(version) and version >= 0, do: version)
    ]
  end

  defp edit_result({:ok, _}), do: :ok
  defp edit_result(error), do: error

  @doc """
  Replaces the schema of a stream of annotations with the draft that was edited in the page. Annotations follow
  renamed attributes and values; a value that annotations use cannot be removed.
  """
  @spec put_schema(pid(), [SchemaForm.attribute()]) :: :ok | {:error, Error.t()}
  def put_schema(editor, draft) do
    old = Editor.current_layer(editor).schema

    with {:ok, schema, renamed} <- SchemaForm.build_schema(old, draft),
         names = Enum.map(schema.attributes, & &1.name),
         do: edit_result(Editor.put_schema(editor, schema, &rename_values(&1, renamed, names)))
  end

  defp rename_values(annotation, renamed, names) do
    values =
      Enum.reduce(renamed, annotation.values, fn {was, now, names}, values ->
        case Map.pop(values, was) do
          {nil, values} -> values
          {value, values} -> Map.put(values, now, Map.get(names, value, value))
        end
      end)

    %{annotation | values: Map.take(values, names)}
  end

  @doc """
  Adds proposals from a stream's intervals, one track per lane, and returns `{:ok, count}`. A state or text that the
  schema knows becomes the value; unknown ones are skipped, as are proposals that overlap with annotations.
  """
  @spec add_proposals(pid(), [Proposals.t()], String.t()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def add_proposals(editor, found, stream) do
    short = stream |> String.split(".") |> List.last()
    before = editor |> Editor.current_layer() |> Layer.annotations() |> length()

    edit = fn layer ->
      proposals =
        for one <- found, values = proposed_values(layer.schema, one.label) do
          track = if one.lane == "", do: short, else: one.lane
          more = [proposed?: true, by: stream, confidence: one.confidence]
          Annotation.new(one.from, one.to, track, values, more)
        end

      Edit.add_proposals(layer, proposals)
    end

    with {:ok, layer} <- Editor.edit(editor, edit),
         do: {:ok, length(Layer.annotations(layer)) - before}
  end

  defp proposed_values(schema, ""), do: Schema.default_values(schema)

  defp proposed_values(%{attributes: attributes} = schema, label) do
    known = Enum.find(attributes, fn a -> Enum.any?(a.values, &(&1.value == label)) end)

    case known || Enum.find(attributes, &(&1.kind == :text)) do
      nil -> nil
      attribute -> Map.put(Schema.default_values(schema), attribute.name, label)
    end
  end

  defp invalid_edit, do: {:error, Error.new(:bad_request, "invalid annotation edit")}
end
