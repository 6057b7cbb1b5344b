defmodule Situ.Studio.Web.LayerDialog do
  @moduledoc false
  # The dialog that opens, creates, copies or continues an annotation layer.
  use Situ.Live.Component
  import Situ.Live.Socket, only: [assign: 2, connected?: 1, push_event: 3]

  alias Situ.Annotation.{Layer, TierText}
  alias Situ.Live.Socket
  alias Situ.Studio.{Annotations, Catalog}
  alias Situ.Studio.Annotations.{Layers, Schemas}
  alias Situ.Studio.Datasets.DatasetRef
  alias Situ.Studio.Web.{AnnotationPanel, SourceList}

  @spec handle_event(String.t(), map(), Socket.t()) :: Socket.t()
  def handle_event(event, params, socket) do
    if AnnotationPanel.available?(socket.assigns),
      do: apply_event(event, params, socket),
      else: AnnotationPanel.refuse(socket)
  end

  @doc "Offers to create the layer that was edited in the previous session, which the page's address names."
  @spec offer_from_params(Socket.t(), map()) :: Socket.t()
  def offer_from_params(
        %{assigns: %{annotation: nil}} = socket,
        %{"annotate" => name, "previous" => id}
      ) do
    with true <- connected?(socket) and AnnotationPanel.available?(socket.assigns),
         %{} = layer <- parse_continued(%{"name" => name, "id" => id}, socket.assigns),
         do: open_dialog(socket, layer),
         else: (_ -> socket)
  end

  def offer_from_params(socket, _), do: socket

  defp apply_event("layer_dialog", _, socket), do: open_dialog(socket, nil)

  defp apply_event("layer_open", %{"stream" => name}, socket) when is_binary(name),
    do: socket |> assign(dialog: nil) |> AnnotationPanel.open_layer(name, nil)

  defp apply_event("layer_new", %{"name" => name, "values" => values} = params, socket)
       when is_binary(name) and is_binary(values) do
    with name when name != "" <- name |> String.trim() |> String.slice(0, 60),
         {:ok, schema} <-
           resolve_schema(params, name, String.slice(values, 0, 4_000), socket.assigns) do
      socket
      |> assign(dialog: nil)
      |> AnnotationPanel.open_layer(layer_name(name, params["by"]), schema)
    else
      "" -> show_toast(socket, "Enter a name for the annotations")
      {:error, error} -> show_toast(socket, Exception.message(error))
    end
  end

  # A layer with the same schema for another annotator, so that the two layers can be compared.
  defp apply_event("layer_own", %{"stream" => name, "by" => by}, socket)
       when is_binary(name) and is_binary(by) do
    with {:ok, layer} <- Layers.read_layer(socket.assigns.studio, socket.assigns.item, name),
         own when own != name <- layer_name(base_name(name, layer.schema.name), by) do
      socket |> assign(dialog: nil) |> AnnotationPanel.open_layer(own, layer.schema)
    else
      {:error, error} -> show_toast(socket, Exception.message(error))
      _same -> show_toast(socket, "The layer needs the name of another annotator")
    end
  end

  # A layer of another partition is copied, so that it can be edited.
  defp apply_event("layer_copy", %{"partition" => partition, "stream" => name}, socket)
       when is_binary(partition) and is_binary(name) do
    %{studio: studio, item: item} = socket.assigns

    case Layers.copy_foreign(studio, item, {partition, name}) do
      {:ok, copy} -> socket |> assign(dialog: nil) |> AnnotationPanel.open_layer(copy, nil)
      {:error, error} -> show_toast(socket, Exception.message(error))
    end
  end

  defp apply_event(
         "layer_continue",
         _,
         %{assigns: %{dialog: {:layers, %{continue: %{}}}}} = socket
       ) do
    {:layers, %{continue: %{name: name, session: session}}} = socket.assigns.dialog
    id = DatasetRef.build_id(socket.assigns.item.dataset, [session])

    case Catalog.fetch_item(socket.assigns.studio, id) do
      {:ok, item} -> open_like(socket, name, item, name)
      {:error, error} -> show_toast(socket, Exception.message(error))
    end
  end

  defp apply_event(_, _, socket), do: socket

  defp open_dialog(socket, continue) do
    %{item: item, layout_dir: layouts} = socket.assigns

    choices = %{
      names: Layers.list_names(item),
      foreign: Layers.list_foreign(item),
      schemas: Schemas.list_names(layouts),
      session?: item.session != nil,
      continue: continue
    }

    assign(socket, dialog: {:layers, choices})
  end

  defp open_like(socket, name, item, like) do
    case Layers.read_layer(socket.assigns.studio, item, like) do
      {:ok, %Layer{schema: schema}} ->
        socket |> assign(dialog: nil) |> AnnotationPanel.open_layer(name, schema)

      {:error, error} ->
        show_toast(socket, Exception.message(error))
    end
  end

  # The page names the session by its address.
  defp parse_continued(%{"name" => name, "id" => id}, assigns)
       when is_binary(name) and is_binary(id) do
    with entry when entry != nil <- Enum.find(SourceList.list_sources(assigns), &(&1.id == id)),
         {:ok, %{session: session} = item} when session != nil <-
           Catalog.fetch_item(assigns.studio, id),
         true <- name in Layers.list_names(item),
         do: %{name: name, session: session},
         else: (_ -> nil)
  end

  defp parse_continued(_, _), do: nil

  # Uses the saved schema that the form names, or builds one from the form's fields.
  defp resolve_schema(%{"schema" => saved}, _name, _values, assigns)
       when is_binary(saved) and saved != "",
       do: Schemas.load(assigns.layout_dir, saved)

  defp resolve_schema(params, name, values, _), do: build_schema(params["kind"], name, values)

  defp build_schema("box", name, _), do: {:ok, Annotations.build_spatial_schema(name, :box)}
  defp build_schema("tiers", name, text), do: TierText.parse_schema(name, text)
  defp build_schema("point", name, _), do: {:ok, Annotations.build_spatial_schema(name, :point)}
  defp build_schema(_, name, values), do: Annotations.parse_schema(name, values)

  # The name of a layer without its annotator: a schema has the name of the first layer that was created with it.
  defp base_name(name, schema),
    do: if(String.starts_with?(name, schema <> "."), do: schema, else: name)

  # The layer of a named annotator has that name as a suffix.
  defp layer_name(stream, by) when is_binary(by) do
    case by |> String.trim() |> String.slice(0, 40) do
      "" -> stream
      by -> "#{stream}.#{by}"
    end
  end

  defp layer_name(stream, _), do: stream

  defp show_toast(socket, text), do: push_event(socket, "toast", %{text: text})

  attr(:names, :list, required: true)
  attr(:foreign, :list, required: true)
  attr(:schemas, :list, required: true)
  attr(:session?, :boolean, required: true)
  attr(:continue, :any, required: true)

  @doc false
  def dialog(assigns) do
    ~H"""
    <dialog id="annotation-dialog" phx-hook="Modal" phx-update="ignore" aria-label="Annotate">
      <h3>Annotate</h3>
      <div :if={@continue} class="choices">
        <button class="btn primary" type="button" phx-click="layer_continue" autofocus>Start {@continue.name} in this
          session, with the schema of {@continue.session}</button>
      </div>
      <div :if={@names != []} class="choices">
        <button :for={name <- @names} class="btn" type="button" phx-click="layer_open"
            phx-value-stream={name}>{name}</button>
      </div>
      <div :if={@foreign != []} class="choices foreign">
        <button :for={{partition, name} <- @foreign} class="btn" type="button" phx-click="layer_copy"
            phx-value-partition={partition} phx-value-stream={name}>Copy {name} of {partition}</button>
      </div>
      <p :if={@foreign != []} class="hint">A copied layer can be edited; the recording that contains the original is
        never modified.</p>
      <form id="annotation-new" phx-submit="layer_new">
        <label>New annotations <input name="name" placeholder="Speech" autocomplete="off" maxlength="60"
            required autofocus={@continue == nil}></label>
        <label>Values, one per line: name, key, color
          <textarea name="values" rows="4" placeholder={"speaks 1 #4ea1f3\nlaughs 2"}></textarea></label>
        <div class="inline">
          <select name="kind" aria-label="Kind of annotation"><option value="values">Segments in time</option><option
              value="tiers">Tiers, one per line: Words in Speech</option><option
              value="box">Boxes on images</option><option value="point">Points on images</option></select>
          <input name="by" placeholder="annotator (optional)" maxlength="40" autocomplete="off"
              aria-label="Annotator">
          <select :if={@schemas != []} name="schema" aria-label="Schema"><option
              value="">Use the values above</option><option
              :for={s <- @schemas} value={s}>Schema {s}</option></select>
        </div>
        <div class="choices">
          <button class="btn primary" type="submit">Annotate</button>
          <button class="btn" type="button" phx-click="dialog_close">Cancel</button>
        </div>
        <p class="hint">Annotations are saved {if @session?, do: "with the session, next to the dataset file",
          else: "next to the recording"}. Recordings are never modified. Every edit is saved immediately.</p>
      </form>
      <form :if={@names != []} id="annotation-own" class="inline" phx-submit="layer_own">
        <select name="stream" aria-label="Annotations whose schema is used"><option
            :for={name <- @names} value={name}>{name}</option></select>
        <input name="by" placeholder="your name" maxlength="40" autocomplete="off" required
            aria-label="Your name, for a separate layer">
        <button class="btn" type="submit">Add my own layer</button>
      </form>
    </dialog>
    """
  end
end
