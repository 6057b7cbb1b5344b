defmodule Situ.Studio.Web.MainView do
  @moduledoc false
  # Serves the page of one recording or pipeline. The browser owns times, cursor and images; this process owns the
  # streams, the layout and the selection of streams and panels.
  use Situ.Live.View

  alias Situ.Studio.{
    Alerts,
    Catalog,
    Comparison,
    Layout,
    Settings,
    StreamReader
  }

  alias Situ.Studio.Web.{
    AlertBox,
    AnnotationPanel,
    BookmarkList,
    PageFrame,
    CompareBar,
    DerivedStreams,
    LayerDialog,
    LayerWatch,
    LayoutEdits,
    ExportDialog,
    VideoExportBox,
    StreamActions,
    StreamFacts,
    LayoutMenu,
    MainAssigns,
    Panels,
    Paths,
    QueryPanel,
    SchemaDialog,
    HistoryDialog,
    Sidebars,
    StreamTree,
    SharedCursors,
    TierDialog
  }

  @refresh_ms 2_000
  # At most this many layout changes can be undone.
  @undo 100
  @max_lanes 32
  # The modules that handle events, by the first word of their names.
  @parts %{
    "annotation" => AnnotationPanel,
    "bookmark" => BookmarkList,
    "export" => ExportDialog,
    "film" => VideoExportBox,
    "layer" => LayerDialog,
    "query" => QueryPanel
  }

  @impl true
  def mount(params, session, socket) do
    studio = session["studio"]
    id = params["id"] |> List.wrap() |> Enum.join("/")
    settings = Catalog.settings(studio)

    socket =
      assign(socket,
        studio: studio,
        id: id,
        page_title: "#{id} - Situ Studio",
        read_only: settings.read_only or session["viewer"] == true,
        viewer: session["viewer"] == true,
        extra: settings.visualizers,
        tiles: settings.tiles,
        layout_dir: settings.layouts,
        query: "",
        closed: MapSet.new(),
        seen_lanes: %{},
        derived: [],
        selected: nil,
        snap: nil,
        maximised: nil,
        annotation: nil,
        query_panel: nil,
        film: nil,
        compared: nil,
        alerts: [],
        undo: [],
        redo: [],
        info: Settings.load(settings.layouts).info,
        keep: Settings.load(settings.layouts).keep,
        dialog: nil,
        error: nil
      )

    case Comparison.open_item(studio, id, params) do
      {:ok, item, source, compared} ->
        if connected?(socket), do: Process.send_after(self(), :refresh, @refresh_ms)
        damage = StreamReader.list_damage(source)
        socket = socket |> assign(item: item, source: source, damage: damage, compared: compared)
        socket = load_streams(socket)
        shapes = socket.assigns.shapes
        stream = existing_stream(params["stream"], shapes)
        socket = assign(socket, snap: existing_stream(params["snap"], shapes))
        socket = assign(socket, selected: stream && {:stream, stream})

        socket =
          socket
          |> LayoutMenu.choose_layout(params)
          |> reload_shifted(socket)
          |> SharedCursors.join()
          |> LayerWatch.join()
          |> BookmarkList.join()

        {:ok,
         socket
         |> DerivedStreams.ensure_loaded(&load_streams/1)
         |> AnnotationPanel.open_from_params(params)
         |> LayerDialog.offer_from_params(params)}

      {:error, %{code: :is_dataset}} ->
        {:ok, redirect(socket, to: "/" <> Paths.dataset_path(id))}

      {:error, error} ->
        {:ok, assign(socket, error: error)}
    end
  end

  defp existing_stream(stream, shapes), do: if(is_map_key(shapes, stream), do: stream)

  defp load_streams(socket), do: StreamFacts.load(socket)

  defp refresh_streams(%{assigns: %{shapes: shapes}} = socket),
    do: socket |> load_streams() |> LayoutMenu.update_automatic(shapes)

  # The streams of a shifted recording have other times, so they are loaded again.
  defp reload_shifted(socket, %{assigns: %{source: source}}),
    do: if(socket.assigns.source == source, do: socket, else: load_streams(socket))

  @impl true
  def handle_event("streams_changed", _, socket) do
    first? = socket.assigns.infos == []
    socket = refresh_streams(socket)
    {:noreply, if(first?, do: LayoutMenu.choose_layout(socket, %{}), else: socket)}
  end

  def handle_event("lanes", %{"of" => of, "count" => n}, socket)
      when is_binary(of) and n in 1..@max_lanes do
    shown = for panel <- socket.assigns.layout.panels, v <- panel.vis, do: v.stream <> v.path

    if of in shown do
      seen = Map.update(socket.assigns.seen_lanes, of, n, &max(&1, n))

      {:noreply,
       assign(socket,
         seen_lanes: seen,
         lanes: StreamFacts.lane_counts(socket.assigns.infos, seen)
       )}
    else
      {:noreply, socket}
    end
  end

  def handle_event(event, params, socket)
      when event in ["search", "toggle", "fold_all", "unfold_all", "fold_below"],
      do: {:noreply, StreamTree.handle_event(event, params, socket)}

  def handle_event(event, params, socket)
      when event in ["select", "snap", "zoom_stream", "statistics"],
      do: {:noreply, StreamActions.handle_event(event, params, socket)}

  def handle_event("layout_" <> _ = event, params, socket) do
    {:noreply, chosen} = LayoutMenu.handle_event(event, params, socket)
    chosen = record_layout_pick(chosen, socket.assigns)
    {:noreply, chosen |> reload_shifted(socket) |> DerivedStreams.ensure_loaded(&load_streams/1)}
  end

  # Adds a stream that an expression derives from other streams.
  def handle_event("derive", %{"text" => text}, socket) when is_binary(text) do
    case DerivedStreams.add_stream(socket, text) do
      {:ok, name, socket} ->
        handle_event("add_stream", %{"stream" => name}, load_streams(socket))

      {:error, error} ->
        {:noreply, show_toast(socket, error)}
    end
  end

  def handle_event("derive_members", %{"stream" => stream}, socket) when is_binary(stream),
    do: {:noreply, DerivedStreams.derive_members(socket, stream, &load_streams/1)}

  def handle_event("compare_" <> _ = event, params, socket)
      when is_map_key(socket.assigns, :item) do
    {:noreply, after_it} = CompareBar.handle_event(event, params, socket)
    {:noreply, after_it |> reload_shifted(socket) |> LayoutMenu.save_changes()}
  end

  # Returns a view-only link. A viewer gets no token, because the page's address already has it.
  def handle_event("viewer_link", _, socket) do
    token = if socket.assigns.viewer, do: nil, else: Situ.Live.viewer_token(socket)
    {:noreply, push_event(socket, "viewer_link", %{token: token})}
  end

  def handle_event("together", params, socket),
    do: {:noreply, SharedCursors.broadcast_view(socket, params)}

  def handle_event("dialog_close", _, socket), do: {:noreply, assign(socket, dialog: nil)}

  def handle_event(event, params, socket) when is_map_key(socket.assigns, :layout) do
    case @parts[event |> String.split("_", parts: 2) |> hd()] do
      nil -> edit_layout(event, params, socket)
      part -> event |> part.handle_event(params, socket) |> to_noreply()
    end
  end

  def handle_event(_, _, socket), do: {:noreply, socket}

  defp to_noreply({:noreply, socket}), do: {:noreply, socket}
  defp to_noreply(socket), do: {:noreply, socket}

  defp edit_layout(event, params, socket) do
    case LayoutEdits.apply_event(event, params, socket.assigns) do
      {:ok, changes} ->
        {:noreply,
         socket |> record_change(event, changes) |> assign(changes) |> LayoutMenu.save_changes()}

      {:error, error} ->
        {:noreply, show_toast(socket, error)}

      :ignore ->
        {:noreply, socket}
    end
  end

  # Saves the previous layout for undo. Picking another layout counts as a change.
  defp record_change(%{assigns: assigns} = socket, event, changes)
       when event not in ["undo", "redo", "select_tab"] do
    if Keyword.get(changes, :layout, assigns.layout) == assigns.layout,
      do: socket,
      else: assign(socket, undo: Enum.take([assigns.layout | assigns.undo], @undo), redo: [])
  end

  defp record_change(socket, _, _), do: socket

  defp record_layout_pick(socket, %{layout: before, undo: undo}) do
    if Layout.same_panels?(socket.assigns.layout, before),
      do: socket,
      else: assign(socket, undo: Enum.take([before | undo], @undo), redo: [])
  end

  @impl true
  def handle_info({:exported, result}, socket) do
    Catalog.invalidate_recordings(socket.assigns.studio)
    {:noreply, result |> ExportDialog.show_result(socket) |> load_streams()}
  end

  def handle_info({:found, run, result}, socket),
    do: {:noreply, QueryPanel.put_result(socket, run, result)}

  def handle_info({:statistics, rows}, socket),
    do: {:noreply, push_event(socket, "statistics", %{rows: rows})}

  def handle_info({:film, key, progress}, socket),
    do: {:noreply, VideoExportBox.update_progress(socket, key, progress)}

  def handle_info({:together, view}, socket),
    do: {:noreply, SharedCursors.push_view(socket, view)}

  def handle_info({:proposed, result}, socket),
    do: {:noreply, AnnotationPanel.report_proposals(socket, result)}

  def handle_info({:situ_annotation, editor, change}, socket),
    do: {:noreply, socket |> AnnotationPanel.show_edit(editor) |> LayerWatch.show_edit(change)}

  def handle_info(:bookmarks_changed, socket), do: {:noreply, BookmarkList.refresh(socket)}

  def handle_info(:layers_changed, socket), do: {:noreply, LayerWatch.refresh(socket)}

  # The facts about a live source keep changing.
  def handle_info(:refresh, socket) do
    Process.send_after(self(), :refresh, @refresh_ms)
    socket = socket |> AnnotationPanel.refresh_editor() |> LayerWatch.check_saved()

    case StreamReader.fetch_extent(socket.assigns.source) do
      {:ok, %{live: true}} -> {:noreply, socket |> refresh_streams() |> load_alerts()}
      _ -> {:noreply, socket}
    end
  end

  def handle_info(_, socket), do: {:noreply, socket}

  defp load_alerts(%{assigns: a} = socket),
    do: assign(socket, alerts: Alerts.list_alerts(a.studio, a.id))

  defp show_toast(socket, error),
    do: push_event(socket, "toast", %{text: Exception.message(error)})

  @impl true
  def render(%{error: %{}} = assigns), do: PageFrame.error_page(assigns)

  def render(assigns) do
    assigns = assign(assigns, MainAssigns.derive_values(assigns))

    ~H"""
    <div id="studio" class="studio" phx-hook="Studio" data-source={@id} data-layout={@saved.name} data-start={@start}
        data-edit={@edit} data-tiles={@tiles && @tiles.url} data-credit={@tiles && @tiles.credit}
        data-annotate={@annotation && @annotation.stream} data-dataset={@item.session && @item.dataset}
        data-keep={@saved.name != Layout.Auto.layout_name() && @keep}>
      <PageFrame.top_bar title={@item.title} layouts={@layouts} layout={@saved.name} changed={@edit != ""}
          read_only={@read_only} export={ExportDialog.available?(assigns)}
          annotate={AnnotationPanel.available?(assigns)} pipeline={@pipeline} session={@item.session != nil} />
      <Sidebars.streams_sidebar sources={@sources} current={@id} rows={@rows} more={@more} query={@query}
          count={length(@infos)} info={@info} snap={@snap} selected={@selected} names={@names}
          parts={Enum.map(@item.parts, &elem(&1, 0))}
          kinds={StreamFacts.encode_visualizers(@extra)} />
      <main class="centre">
        <PageFrame.damage_notice :if={@damage != []} damage={@damage} path={@item.path} />
        <AlertBox.alert_list alerts={@alerts} />
        <CompareBar.comparison_bar :if={@compared} compared={@compared} title={@item.title} />
        <VideoExportBox.export_status :if={@film} film={@film} />
        <button class="pill" type="button" data-act="live"
          title="Follow the live data (l)">Back to live</button>
        <Panels.panel_stack layout={@layout} selected={@selected} maximised={@maximised} known={@known}
          annotation={@annotation && @annotation.stream} streams={length(@infos)} more={@more_streams} />
      </main>
      <Sidebars.properties_sidebar stream={@stream} group={@group} panel={@panel} known={@known} snap={@snap} />
      <BookmarkList.bookmark_list bookmarks={@bookmarks} read_only={@read_only} />
      <QueryPanel.search_panel :if={@query_panel} panel={@query_panel} from={StreamFacts.data_start(assigns)}
          annotate={AnnotationPanel.available?(assigns)} />
      <PageFrame.status_bar infos={@infos} layout={@layout} source={@item.title} read_only={@read_only} viewer={@viewer}
          snap={@snap} />
      <LayerDialog.dialog :if={match?({:layers, _}, @dialog)} {elem(@dialog, 1)} />
      <SchemaDialog.dialog :if={match?({:schema, _, _}, @dialog)} draft={elem(@dialog, 1)} error={elem(@dialog, 2)} />
      <TierDialog.dialog :if={match?({:tiers, _}, @dialog)} {elem(@dialog, 1)} />
      <HistoryDialog.history_dialog :if={match?({:history, _, _}, @dialog)} entries={elem(@dialog, 1)}
          restore={elem(@dialog, 2)} />
      <CompareBar.comparison_dialog :if={match?({:compare, _}, @dialog)} others={elem(@dialog, 1)} />
      <LayoutMenu.save_dialog :if={@dialog == :layout} saved={@saved} />
      <ExportDialog.export_dialog :if={match?({:export, _, _, _}, @dialog)} dialog={@dialog} item={@item}
          layout={@layout} shapes={@shapes} />
    </div>
    <PageFrame.script_dialogs />
    """
  end
end
