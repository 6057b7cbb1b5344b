defmodule Situ.Studio.Web.AnnotationPanel do
  @moduledoc false
  # Handles annotation in the main view: the panel that edits a layer, and the events that pass the page's edits to
  # `Situ.Studio.Annotations`. `Situ.Studio.Web.LayerDialog` handles the events that open a layer.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, push_event: 3]

  alias Situ.Annotation.{Editor, Layer, Schema}
  alias Situ.Live.Socket
  alias Situ.Studio.Annotations

  alias Situ.Studio.Annotations.{
    AgreementTable,
    Layers,
    MergedView,
    Proposals,
    SchemaForm,
    Schemas
  }

  alias Situ.Studio.Web.{HistoryDialog, LayerWatch, TierDialog}

  @doc "Returns whether the item can have annotation layers and the studio may write them."
  @spec available?(map()) :: boolean()
  def available?(%{read_only: read_only, item: item}), do: item.layers != nil and not read_only

  @doc "Opens the annotation stream that the page's address names, if it exists."
  @spec open_from_params(Socket.t(), map()) :: Socket.t()
  def open_from_params(socket, %{"annotate" => stream}) when is_binary(stream) and stream != "" do
    if available?(socket.assigns) and stream in Layers.list_names(socket.assigns.item),
      do: open_layer(socket, stream, nil),
      else: socket
  end

  def open_from_params(socket, _), do: socket

  @spec handle_event(String.t(), map(), Socket.t()) :: {:noreply, Socket.t()}
  def handle_event(event, params, socket) do
    if available?(socket.assigns),
      do: {:noreply, apply_event(event, params, socket)},
      else: {:noreply, refuse(socket)}
  end

  @doc "Shows why the item cannot be annotated."
  @spec refuse(Socket.t()) :: Socket.t()
  def refuse(socket) do
    show_toast(
      socket,
      "Cannot annotate this: annotations need a recording on disk or a session of a dataset file (.json), " <>
        "and a studio that is not read-only"
    )
  end

  defp apply_event("annotation_schema", _, %{assigns: %{annotation: %{editor: editor}}} = socket),
    do:
      assign(socket,
        dialog: {:schema, SchemaForm.from_schema(Editor.current_layer(editor).schema), nil}
      )

  defp apply_event(
         "annotation_draft",
         params,
         %{assigns: %{dialog: {:schema, draft, _}}} = socket
       ),
       do:
         assign(socket,
           dialog: {:schema, SchemaForm.update_from_params(draft, params["attribute"]), nil}
         )

  defp apply_event("annotation_row", params, %{assigns: %{dialog: {:schema, draft, _}}} = socket) do
    at = parse_index(params["at"])

    draft =
      case params["do"] do
        "attribute" -> SchemaForm.add_entry(draft, :attribute)
        "add" when at != nil -> SchemaForm.add_entry(draft, at)
        "remove" when at != nil -> SchemaForm.remove_entry(draft, at, parse_index(params["nth"]))
        _ -> draft
      end

    assign(socket, dialog: {:schema, draft, nil})
  end

  defp apply_event(
         "annotation_schema_save",
         params,
         %{assigns: %{dialog: {:schema, draft, _}}} = socket
       ) do
    draft = SchemaForm.update_from_params(draft, params["attribute"])

    with %{editor: editor} <- socket.assigns.annotation,
         :ok <- Annotations.put_schema(editor, draft) do
      socket |> assign(dialog: nil) |> push_annotations()
    else
      {:error, error} -> assign(socket, dialog: {:schema, draft, Exception.message(error)})
      nil -> assign(socket, dialog: nil)
    end
  end

  # Saves the schema so that other recordings can use it.
  defp apply_event(
         "annotation_schema_keep",
         _,
         %{assigns: %{dialog: {:schema, draft, _}}} = socket
       ) do
    with %{editor: editor} <- socket.assigns.annotation,
         %{name: name} = old <- Editor.current_layer(editor).schema,
         {:ok, schema, _} <- SchemaForm.build_schema(old, draft),
         :ok <- Schemas.save_schema(socket.assigns.layout_dir, schema) do
      show_toast(socket, "Saved as #{name} for other recordings")
    else
      {:error, error} -> assign(socket, dialog: {:schema, draft, Exception.message(error)})
      nil -> socket
    end
  end

  defp apply_event("annotation_history" <> _ = event, params, socket),
    do: HistoryDialog.handle_layer(event, params, socket)

  defp apply_event("annotation_tiers" <> _ = event, params, socket),
    do: TierDialog.handle_event(event, params, socket)

  # A marker comments on a time or a range. Markers are an ordinary annotation stream of texts; a marker that overlaps
  # an earlier one goes to the next track.
  defp apply_event(
         "annotation_marker",
         %{"from" => from, "to" => to, "text" => text} = params,
         socket
       )
       when is_binary(text) do
    %{studio: studio, item: item} = socket.assigns
    {:ok, schema} = Annotations.parse_schema("Markers", "")
    values = %{"Markers" => String.slice(text, 0, 500)}

    add =
      Map.merge(
        %{"do" => "add", "from" => from, "to" => to, "values" => values},
        take_annotator(params)
      )

    with {:ok, editor} <- Layers.open_editor(studio, item, "Markers", schema),
         :ok <- add_to_free_track(editor, add, 1) do
      open_layer(socket, "Markers", nil)
    else
      {:error, error} -> show_toast(socket, Exception.message(error))
    end
  end

  defp apply_event("annotation_streams", _, %{assigns: %{annotation: %{stream: mine}}} = socket) do
    others = Layers.list_names(socket.assigns.item) -- [mine]
    push_event(socket, "annotation_streams", %{streams: others})
  end

  defp apply_event(
         "annotation_compare",
         %{"with" => other},
         %{assigns: %{annotation: %{} = mine}} = socket
       )
       when is_binary(other) do
    %{studio: studio, item: item} = socket.assigns

    with {:ok, editor} <- Layers.open_editor(studio, item, other, nil),
         {:ok, rows} <-
           AgreementTable.agreement_rows(
             Editor.current_layer(mine.editor),
             Editor.current_layer(editor)
           ) do
      rows = Enum.map(rows, &Tuple.to_list/1)
      push_event(socket, "agreement", %{first: mine.stream, second: other, rows: rows})
    else
      {:error, error} -> show_toast(socket, Exception.message(error))
    end
  end

  defp apply_event("annotation_merged", _, %{assigns: %{annotation: %{} = mine}} = socket) do
    case socket.assigns |> MergedView.list_layers(mine) |> MergedView.page_state() do
      {:ok, state} -> push_event(socket, "annotation_merged", state)
      {:error, error} -> show_toast(socket, Exception.message(error))
    end
  end

  # The consensus is a separate layer: the annotations on which the annotators agree, and proposals for a review.
  defp apply_event("annotation_consensus", _, %{assigns: %{annotation: %{} = mine}} = socket) do
    with [_, _ | _] = layers <- MergedView.list_layers(socket.assigns, mine),
         {:ok, layer} <- MergedView.build_consensus(layers),
         {:ok, name} <-
           Layers.create_layer(socket.assigns, layer.schema.name <> ".consensus", layer) do
      socket
      |> open_layer(name, nil)
      |> show_toast("Created #{name}; q reviews the disagreements")
    else
      [_] -> show_toast(socket, "There is no other layer with the same attributes")
      {:error, error} -> show_toast(socket, Exception.message(error))
    end
  end

  defp apply_event("annotation_close", _, socket),
    do: socket |> assign(annotation: nil) |> LayerWatch.refresh()

  defp apply_event("annotation_ready", _, socket), do: push_annotations(socket)

  # A stream may be long, so a task searches it while the page stays responsive.
  defp apply_event(
         "annotation_propose",
         %{"stream" => stream} = params,
         %{assigns: %{annotation: %{editor: editor}}} = socket
       )
       when is_binary(stream) do
    %{source: source, shapes: shapes} = socket.assigns
    threshold = if is_number(params["threshold"]), do: params["threshold"], else: 0.5
    page = self()

    Task.Supervisor.start_child(Situ.Studio.Tasks, fn ->
      with {:ok, found} <- Proposals.collect_proposals(source, stream, shapes[stream], threshold) do
        send(page, {:proposed, Annotations.add_proposals(editor, found, stream)})
      else
        error -> send(page, {:proposed, error})
      end
    end)

    show_toast(socket, "Searching #{stream} ...")
  end

  # Lists the tracks of all layers, so that the user can copy their boundaries.
  defp apply_event("annotation_tracks", _, %{assigns: %{annotation: %{}}} = socket) do
    %{studio: studio, item: item} = socket.assigns

    tracks =
      for stream <- Layers.list_names(item),
          {:ok, editor} <- [Layers.open_editor(studio, item, stream, nil)],
          track <- Layer.track_names(Editor.current_layer(editor)),
          do: [stream, track]

    push_event(socket, "annotation_tracks", %{tracks: tracks})
  end

  defp apply_event(
         "annotation_edit",
         %{"do" => "copy_boundaries", "stream" => stream} = params,
         %{assigns: %{annotation: %{editor: editor}}} = socket
       )
       when is_binary(stream) do
    %{studio: studio, item: item} = socket.assigns

    with {:ok, other} <- Layers.open_editor(studio, item, stream, nil),
         :ok <-
           Annotations.apply_edit(editor, Map.put(params, :layer, Editor.current_layer(other))) do
      socket
    else
      {:error, error} -> show_toast(socket, Exception.message(error))
    end
  end

  defp apply_event(
         "annotation_edit",
         params,
         %{assigns: %{annotation: %{editor: editor}}} = socket
       ) do
    case Annotations.apply_edit(editor, params) do
      :ok -> if(params["do"] == "save", do: show_toast(socket, "Annotations saved"), else: socket)
      {:error, error} -> socket |> show_toast(Exception.message(error)) |> push_annotations()
    end
  end

  defp apply_event(_, _, socket), do: socket

  defp take_annotator(params), do: Map.take(params, ["by"])

  defp add_to_free_track(editor, add, n) do
    case Annotations.apply_edit(editor, Map.put(add, "track", "#{n}")) do
      {:error, %{code: :overlap}} when n < 20 -> add_to_free_track(editor, add, n + 1)
      result -> result
    end
  end

  defp parse_index(text) do
    case Integer.parse(to_string(text)) do
      {n, ""} when n >= 0 -> n
      _ -> nil
    end
  end

  @doc "Shows the number of proposals found in a stream, or the error."
  @spec report_proposals(Socket.t(), {:ok, non_neg_integer()} | {:error, Situ.Error.t()}) ::
          Socket.t()
  def report_proposals(socket, {:ok, 0}), do: show_toast(socket, "Nothing new to propose")
  def report_proposals(socket, {:ok, 1}), do: show_toast(socket, "1 proposal")
  def report_proposals(socket, {:ok, n}), do: show_toast(socket, "#{n} proposals")
  def report_proposals(socket, {:error, error}), do: show_toast(socket, Exception.message(error))

  @doc "Opens a layer, or creates it with a schema."
  @spec open_layer(Socket.t(), String.t(), Schema.t() | nil) :: Socket.t()
  def open_layer(socket, stream, schema) do
    case Layers.open_editor(socket.assigns.studio, socket.assigns.item, stream, schema) do
      {:ok, editor} ->
        :ok = Editor.subscribe(editor)

        socket
        |> assign(annotation: %{stream: stream, editor: editor})
        |> push_annotations()
        |> LayerWatch.announce()

      {:error, error} ->
        show_toast(socket, Exception.message(error))
    end
  end

  @doc "Asks the editor to check whether another program has saved the annotations; it notifies the page if so."
  @spec refresh_editor(Socket.t()) :: Socket.t()
  def refresh_editor(%{assigns: %{annotation: %{editor: editor}}} = socket) do
    _ = Editor.refresh(editor)
    socket
  catch
    :exit, _ -> assign(socket, annotation: nil)
  end

  def refresh_editor(socket), do: socket

  @doc "Sends the current annotations to the page if they have changed in this editor."
  @spec show_edit(Socket.t(), pid()) :: Socket.t()
  def show_edit(%{assigns: %{annotation: %{editor: editor}}} = socket, editor),
    do: push_annotations(socket)

  def show_edit(socket, _editor), do: socket

  @doc "Sends the current annotations to the page."
  @spec push_annotations(Socket.t()) :: Socket.t()
  def push_annotations(%{assigns: %{annotation: %{editor: editor, stream: stream}}} = socket) do
    push_event(socket, "annotations", Annotations.page_state(editor, stream))
  catch
    :exit, _ -> assign(socket, annotation: nil)
  end

  def push_annotations(socket), do: socket

  defp show_toast(socket, text), do: push_event(socket, "toast", %{text: text})

  attr(:stream, :string, required: true)

  @doc false
  def annotation_panel(assigns) do
    ~H"""
    <section class="panel-box timeline annotation" id="annotation" data-menu="annotation">
      <div id="annotation-body" class="panel-body" phx-hook="Annotations" phx-update="ignore" tabindex="0"
          role="application" aria-label={"Annotations " <> @stream}></div>
    </section>
    """
  end
end
