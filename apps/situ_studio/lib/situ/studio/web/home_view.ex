defmodule Situ.Studio.Web.HomeView do
  @moduledoc false
  # Serves the start page, a list of datasets, running pipelines and recordings.
  use Situ.Live.View
  import Situ.Studio.Web.Icons
  import Situ.Studio.Web.StartPanel, only: [start_panel: 1]
  alias Situ.Dataset
  alias Situ.Studio.{Alerts, Catalog, Export, StreamTotals}
  alias Situ.Studio.Datasets.Summary
  alias Situ.Studio.Web.{ClusterView, Paths, StartPanel}

  @refresh_ms 2_000
  # The page shows at most this many rows, and reads the facts of at most this many recordings and datasets.
  @most 400
  @looked_into [:dataset, :store, :elsewhere, :source]

  @impl true
  def mount(_params, session, socket) do
    if connected?(socket), do: Process.send_after(self(), :refresh, @refresh_ms)

    socket =
      assign(socket,
        studio: session["studio"],
        page_title: "Situ Studio",
        query: "",
        problems: Catalog.settings(session["studio"]).problems,
        facts: %{},
        stamps: %{}
      )
      |> assign(StartPanel.initial_assigns(session["studio"], session["viewer"] == true))

    {:ok, load_items(socket)}
  end

  @impl true
  def handle_info(:refresh, socket) do
    Process.send_after(self(), :refresh, @refresh_ms)
    {:noreply, load_items(socket)}
  end

  def handle_info({:facts, id, facts}, socket),
    do: {:noreply, assign(socket, facts: Map.put(socket.assigns.facts, id, facts))}

  def handle_info({:start_panel, _, _} = message, socket),
    do: {:noreply, StartPanel.handle_info(message, socket)}

  def handle_info(_, socket), do: {:noreply, socket}

  # A page of another studio version may send events that are unknown here.
  @impl true
  def handle_event("search", %{"query" => query}, socket) when is_binary(query),
    do: {:noreply, assign(socket, query: String.slice(query, 0, 200))}

  def handle_event("start_" <> _ = event, params, socket),
    do: {:noreply, StartPanel.handle_event(event, params, socket)}

  def handle_event(
        "new_dataset",
        %{"name" => name},
        %{assigns: %{start: %{folder: folder}}} = socket
      )
      when is_binary(name) and folder != nil do
    name = String.trim(name)
    file = Path.join(folder, name <> ".json")

    with :ok <- Export.check_name(name),
         false <- File.exists?(file),
         {:ok, _} <- Dataset.new(name, file: file, autosave: true) do
      Catalog.invalidate_recordings(socket.assigns.studio)
      {:noreply, push_event(socket, "go", %{href: Paths.dataset_path(name <> ".json")})}
    else
      true -> {:noreply, show_toast(socket, "#{name}.json already exists")}
      {:error, error} -> {:noreply, show_toast(socket, Exception.message(error))}
    end
  end

  def handle_event(_event, _params, socket), do: {:noreply, socket}

  defp show_toast(socket, text), do: push_event(socket, "toast", %{text: text})

  defp load_items(socket) do
    items = Catalog.list(socket.assigns.studio)
    socket = assign(socket, items: items)
    if connected?(socket), do: refresh_facts(socket), else: socket
  end

  # Another process reads the recordings one after the other, so the list appears immediately.
  defp refresh_facts(socket) do
    %{items: items, stamps: old, facts: facts, studio: studio} = socket.assigns
    items = for item <- Enum.take(items, @most), item.kind in @looked_into, do: item
    stamps = Map.new(items, &{&1.id, item_stamp(&1, facts[&1.id])})
    changed = Enum.reject(items, &(old[&1.id] == stamps[&1.id]))
    page = self()

    if changed != [] do
      Task.Supervisor.start_child(Situ.Studio.Tasks, fn ->
        Enum.each(changed, &send(page, {:facts, &1.id, read_facts(studio, &1)}))
      end)
    end

    assign(socket, stamps: stamps)
  end

  # Streams in memory have no file whose change could be detected, so live ones are read every time.
  defp item_stamp(%{kind: :source}, %{live: true}), do: make_ref()
  defp item_stamp(%{kind: :source}, _), do: :in_memory
  defp item_stamp(%{path: path}, _), do: Summary.file_stamp(path)

  # The catalog knows the tokens of other machines.
  defp read_facts(studio, %{kind: kind, id: id}) when kind in [:source, :elsewhere] do
    case Catalog.open_source(studio, id) do
      {:ok, _item, source} -> Summary.of_source(source)
      {:error, error} -> %Summary{error: error}
    end
  end

  defp read_facts(_studio, %{kind: :dataset, path: path}), do: Summary.of_dataset(path)
  defp read_facts(_studio, %{path: path}), do: Summary.of_recording(path)

  @impl true
  def render(assigns) do
    words = assigns.query |> String.downcase() |> String.split()
    found = Enum.filter(assigns.items, &matches?(&1, assigns.facts, words))
    assigns = assign(assigns, found: Enum.take(found, @most), more: max(length(found) - @most, 0))

    ~H"""
    <main class="home" id="home" phx-hook="Lists">
      <h1><.logo /><span>Situ Studio</span></h1>
      <div :if={@problems != []} class="damage" role="alert">
        <span :for={{plugin, what} <- @problems}><b>The plug-in {plugin} is broken:</b> {what}</span>
      </div>
      <p class="hint" role="status">{count_text(length(@items), length(@found), @query)} ·
        <a class="linkish" href="settings" data-settings>Settings</a></p>
      <p :if={ClusterView.cluster_member?()} class="hint"><a href="cluster">The cluster: nodes, parts, links</a></p>
      <nav id="recent" class="hint recent" phx-update="ignore" aria-label="Recently viewed" hidden></nav>
      <form :if={length(@items) > 5 or @query != ""} class="search" phx-change="search" phx-submit="search"
          id="search-form">
        <input id="search" name="query" value={@query} placeholder="Search names and streams  /" autocomplete="off"
            phx-debounce="80" aria-label="Search names and streams">
      </form>
      <div class="list">
        <a :for={item <- @found} :key={row_id(item)} id={row_id(item)} class="item" href={Paths.item_path(item)}>
          <.item_thumbnail item={item} facts={@facts[item.id]} />
          <span><b>{item.title}</b><span class="dim"><span
            :for={fact <- describe_item(item, @facts[item.id])}>{fact}</span></span></span>
          <span><.item_badges item={item} facts={@facts[item.id]}
            alerts={if item.kind == :pipeline, do: Alerts.count_active(@studio, item.id), else: 0} /></span></a>
      </div>
      <p :if={@more > 0} class="hint more">{@more} more: use the search to find them</p>
      <p :if={@items == []} class="hint">No recordings yet. New recordings appear automatically.</p>
      <.start_panel :if={@start} start={@start} open={@items == []} />
      <details :if={@start && @start.folder} class="new-dataset">
        <summary>New dataset</summary>
        <form id="new-dataset" class="search" phx-submit="new_dataset">
          <input name="name" aria-label="Name of the new dataset" placeholder="Name" maxlength="60" required
              autocomplete="off">
          <button class="btn primary" type="submit">Create</button>
        </form>
      </details>
      <div id="toast" role="status" phx-update="ignore"></div>
    </main>
    """
  end

  # The id lets the browser move a row. Without it, a re-sorted row would change its text under the mouse pointer.
  defp row_id(item), do: "#{item.kind}-#{item.id}"

  defp matches?(_item, _facts, []), do: true

  defp matches?(item, facts, words) do
    streams = for %{streams: streams} <- [facts[item.id]], s <- streams, do: s.name
    text = [item.title | streams] |> Enum.join("\n") |> String.downcase()
    Enum.all?(words, &String.contains?(text, &1))
  end

  attr(:item, :any, required: true)
  attr(:facts, :any, required: true)

  defp item_thumbnail(assigns) do
    ~H"""
    <img :if={has_thumbnail?(@facts)} class="thumb" alt="" loading="lazy" width="96" height="54"
        src={Paths.thumbnail_path(@item.id)}>
    <span :if={not has_thumbnail?(@facts)} class="thumb"><.icon
        name={if @item.kind == :pipeline, do: :pipeline, else: :store} /></span>
    """
  end

  defp has_thumbnail?(nil), do: false

  defp has_thumbnail?(facts),
    do: Enum.any?(facts.streams, &(&1.shape in [:image, :audio, :signal] and &1.count > 0))

  attr(:item, :any, required: true)
  attr(:facts, :any, required: true)
  attr(:alerts, :integer, required: true)

  defp item_badges(assigns) do
    ~H"""
    <span :if={@alerts > 0} class="badge damaged alerts">{@alerts} {if @alerts == 1, do: "alert", else: "alerts"}</span>
    <span :if={@item.live or (@facts != nil and @facts.live)} class="badge live">live</span>
    <span :if={@facts != nil and (@facts.damaged or @facts.error != nil)} class="badge damaged"
        title={@facts.error && @facts.error.what}>{if @facts.error, do: "cannot be opened", else: "damaged"}</span>
    """
  end

  defp describe_item(item, facts),
    do: [kind_text(item) | format_facts(facts, item)] ++ List.wrap(modification_time(item))

  defp format_facts(nil, _), do: []
  defp format_facts(%{error: %{}}, _), do: []
  defp format_facts(%{sessions: 1}, %{kind: :dataset}), do: ["1 session"]
  defp format_facts(%{sessions: n}, %{kind: :dataset}), do: ["#{n} sessions"]

  defp format_facts(facts, item) do
    streams = length(facts.streams)

    Enum.reject(
      [
        format_segments(facts),
        Summary.format_duration(facts),
        format_pauses(facts),
        if(streams == 1, do: "1 stream", else: "#{streams} streams"),
        # The memory used by messages is not measured.
        if(item.kind == :source, do: "", else: StreamTotals.format_bytes(facts.size))
      ],
      &(&1 == "")
    )
  end

  defp format_segments(%{segments: 0}), do: ""
  defp format_segments(%{segments: 1}), do: "1 segment"
  defp format_segments(%{segments: n}), do: "#{n} segments"

  defp format_pauses(%{pauses: 0}), do: ""
  defp format_pauses(%{pauses: 1}), do: "1 gap"
  defp format_pauses(%{pauses: n}), do: "#{n} gaps"

  # Returns the time of the last write, in this machine's time zone.
  defp modification_time(%{path: path}) when is_binary(path) do
    newest = Situ.Store.Folder.resolve_store(path) || path

    case File.stat(newest, time: :local) do
      {:ok, %{mtime: mtime}} ->
        mtime |> NaiveDateTime.from_erl!() |> NaiveDateTime.to_string() |> String.slice(0, 16)

      _ ->
        nil
    end
  end

  defp modification_time(_), do: nil

  # Annotation files are named after their recording, in the same folder (`Situ.Studio.Annotations.Files`).
  defp kind_text(%{kind: :store, title: title}) do
    case String.split(Path.basename(title), "-annotation-", parts: 2) do
      [of, _] when of != "" -> "annotations of #{of}"
      _ -> "recording"
    end
  end

  defp kind_text(%{kind: :elsewhere}), do: "recording on another machine"
  defp kind_text(%{kind: :pipeline}), do: "running pipeline"
  defp kind_text(%{kind: :source}), do: "in memory"
  defp kind_text(%{kind: :dataset}), do: "dataset"

  defp count_text(1, _, ""), do: "1 item"
  defp count_text(n, _, ""), do: "#{n} items"
  defp count_text(n, found, _), do: "#{found} of #{n}"
end
