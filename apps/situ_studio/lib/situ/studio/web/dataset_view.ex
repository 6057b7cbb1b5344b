defmodule Situ.Studio.Web.DatasetView do
  @moduledoc false
  # Serves the page of a dataset: its tree, the properties of the selected row, and its batch runs.
  use Situ.Live.View

  alias Situ.Dataset.Server
  alias Situ.Studio.{BatchRuns, Catalog, Datasets, Experiments, Export, StreamTotals}
  alias Situ.Studio.BatchRuns.ResumableRuns
  alias Situ.Studio.Datasets.Summary
  alias Situ.Studio.Web.Dataset.{BatchDialog, Components, Dialogs, Edits, SessionSearch}
  alias Situ.Studio.Web.{HistoryDialog, PageFrame, Paths}

  @refresh_ms 2_000

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
        folder: settings.layouts,
        tasks: for(module <- Situ.Dataset.Task.list_tasks(), do: module.task()),
        facts: %{},
        stamps: %{},
        open: MapSet.new(),
        query: "",
        info: :duration,
        selected: [],
        dialog: nil,
        runs: [],
        left: [],
        now: now_ms(),
        experiments?: false,
        error: nil
      )

    with {:ok, %{kind: :dataset, path: file}} <- Catalog.fetch_item(studio, id),
         {:ok, server} <- Datasets.open_server(studio, file) do
      runs = BatchRuns.subscribe(studio, file)
      if connected?(socket), do: Process.send_after(self(), :refresh, @refresh_ms)

      socket =
        assign(socket, file: file, server: server, dataset: Server.get_dataset(server), runs: runs)

      socket =
        assign(socket,
          left: ResumableRuns.list_interrupted(file),
          experiments?: Experiments.any?(file)
        )

      {:ok, if(connected?(socket), do: refresh_facts(socket), else: socket)}
    else
      {:error, error} ->
        {:ok, assign(socket, error: error)}

      {:ok, _} ->
        {:ok, assign(socket, error: Situ.Error.new(:not_found, "#{id} is not a dataset"))}
    end
  end

  # A separate process reads the recordings, so a read that hangs does not block the page.
  defp refresh_facts(socket) do
    paths = for s <- socket.assigns.dataset.sessions, p <- s.partitions, uniq: true, do: p.path
    stamps = Map.new(paths, &{&1, Summary.file_stamp(&1)})
    changed = Enum.reject(paths, &(socket.assigns.stamps[&1] == stamps[&1]))
    page = self()

    if changed != [] do
      Task.Supervisor.start_child(Situ.Studio.Tasks, fn ->
        Situ.Studio.Tasks
        |> Task.Supervisor.async_stream_nolink(changed, &{&1, Summary.of_recording(&1)},
          ordered: false,
          timeout: 30_000,
          on_timeout: :kill_task
        )
        |> Stream.chunk_every(20)
        |> Enum.each(&send(page, {:facts, for({:ok, known} <- &1, do: known)}))
      end)
    end

    assign(socket, stamps: stamps)
  end

  @impl true
  def handle_event("search", %{"query" => query} = params, socket) when is_binary(query) do
    info = StreamTotals.parse_choice(params["info"], socket.assigns.info)
    {:noreply, assign(socket, query: String.slice(query, 0, 200), info: info)}
  end

  def handle_event("fold_all", _, socket), do: {:noreply, assign(socket, open: MapSet.new())}

  def handle_event("unfold_all", _, socket) do
    open = for s <- socket.assigns.dataset.sessions, into: MapSet.new(), do: [s.name]
    {:noreply, assign(socket, open: open)}
  end

  def handle_event("fold_below", params, socket) do
    %{dataset: dataset, open: open} = socket.assigns
    path = Edits.parse_path(params)

    all =
      for s <- dataset.sessions,
          row <- [[s.name] | Enum.map(s.partitions, &[s.name, &1.name])],
          List.starts_with?(row, path),
          into: MapSet.new(),
          do: row

    change = if params["open"], do: &MapSet.union/2, else: &MapSet.difference/2
    {:noreply, assign(socket, open: change.(open, all))}
  end

  def handle_event("toggle", params, socket) do
    open = socket.assigns.open
    path = Edits.parse_path(params)

    {:noreply,
     assign(socket,
       open: if(path in open, do: MapSet.delete(open, path), else: MapSet.put(open, path))
     )}
  end

  def handle_event("select", params, socket),
    do: {:noreply, assign(socket, selected: Edits.parse_path(params))}

  def handle_event("dialog_close", _, socket) do
    SessionSearch.close_dialog(socket.assigns.dialog)
    {:noreply, assign(socket, dialog: nil)}
  end

  def handle_event("find_" <> _ = event, params, %{assigns: %{server: _}} = socket),
    do: {:noreply, SessionSearch.handle_event(event, params, socket)}

  # All events below modify the dataset or its recordings.
  def handle_event(_, _, %{assigns: %{read_only: true}} = socket),
    do: {:noreply, show_toast(socket, "This studio is read-only")}

  def handle_event("run_" <> _ = event, params, socket),
    do: {:noreply, BatchDialog.handle_event(event, params, socket)}

  def handle_event("task", params, socket),
    do: {:noreply, BatchDialog.open_dialog(socket, params["task"], Edits.parse_path(params))}

  # The copy may take long, so it runs in a task that continues after the page is closed.
  def handle_event("save_part", params, %{assigns: %{dialog: {:export, _, _}}} = socket) do
    case Edits.parse_export(params, socket.assigns.dialog) do
      {:ok, export, item} ->
        page = self()
        task = {Task, fn -> send(page, {:exported, Export.write_recording(export, item)}) end}

        {:ok, _} =
          DynamicSupervisor.start_child(Catalog.watch_supervisor(socket.assigns.studio), task)

        {:noreply, socket |> assign(dialog: nil) |> show_toast("Saving #{export.name} ...")}

      {:error, error} ->
        {:noreply, show_toast(socket, Exception.message(error))}
    end
  end

  def handle_event("history_" <> _ = event, params, %{assigns: %{server: _}} = socket),
    do: {:noreply, HistoryDialog.handle_dataset(event, params, socket)}

  def handle_event(event, params, %{assigns: %{server: _}} = socket) do
    case Edits.apply_event(event, params, socket.assigns) do
      {:ok, changes} -> {:noreply, apply_changes(socket, changes)}
      {:error, error} -> {:noreply, show_toast(socket, Exception.message(error))}
      :ignore -> {:noreply, socket}
    end
  end

  def handle_event(_, _, socket), do: {:noreply, socket}

  # Besides changed assigns, an edit may return a message to show or an address to go to.
  defp apply_changes(socket, changes) do
    {toast, changes} = Keyword.pop(changes, :toast)
    {go, changes} = Keyword.pop(changes, :go)
    socket = socket |> assign(changes) |> refresh_facts()
    socket = if toast, do: show_toast(socket, toast), else: socket
    if go, do: push_event(socket, "go", %{href: go}), else: socket
  end

  @impl true
  def handle_info({:exported, {:ok, path}}, socket) do
    Catalog.invalidate_recordings(socket.assigns.studio)
    {:noreply, show_toast(socket, "Saved as #{path}")}
  end

  def handle_info({:exported, {:error, error}}, socket),
    do: {:noreply, show_toast(socket, Exception.message(error))}

  def handle_info({:session_found, run, session, result}, socket),
    do: {:noreply, SessionSearch.put_result(socket, run, {session, result})}

  def handle_info({:facts, known}, socket),
    do: {:noreply, assign(socket, facts: Map.merge(socket.assigns.facts, Map.new(known)))}

  def handle_info({:situ_dataset, server, _}, socket),
    do: {:noreply, socket |> assign(dataset: Server.get_dataset(server)) |> refresh_facts()}

  def handle_info({:batch, _file, runs}, socket),
    do: {:noreply, assign(socket, runs: runs, now: now_ms())}

  def handle_info(:refresh, %{assigns: %{server: server}} = socket) do
    Process.send_after(self(), :refresh, @refresh_ms)

    # The file may have been edited by hand or on the command line. The page is then notified as of any change.
    _ = Datasets.reload_dataset(server)
    socket = assign(socket, experiments?: Experiments.any?(socket.assigns.file))
    {:noreply, refresh_facts(socket)}
  end

  def handle_info(_, socket), do: {:noreply, socket}

  defp show_toast(socket, text), do: push_event(socket, "toast", %{text: text})
  defp now_ms, do: System.monotonic_time(:millisecond)

  @impl true
  def render(%{error: %{}} = assigns), do: PageFrame.error_page(assigns)

  def render(assigns) do
    ~H"""
    <div id="dataset" class="dataset" phx-hook="Lists" data-id={@id}>
      <Components.top_bar title={@dataset.name} file={@file} read_only={@read_only} kept={@dataset.file != nil}
          experiments={@experiments? && Paths.experiments_path(@id)} />
      <Components.session_tree
          {Map.take(assigns, [:dataset, :facts, :open, :query, :info, :selected, :id, :tasks, :read_only])} />
      <Components.dataset_sidebar
          {Map.take(assigns, [:dataset, :facts, :selected, :id, :read_only, :runs, :left, :now])} />
      <HistoryDialog.history_dialog :if={match?({:history, _, _}, @dialog)} entries={elem(@dialog, 1)}
          restore={elem(@dialog, 2)} />
      <SessionSearch.dialog :if={match?({:search, _}, @dialog)} search={elem(@dialog, 1)} id={@id} />
      <Dialogs.dataset_dialog :if={@dialog != nil and elem(@dialog, 0) not in [:history, :search]} dialog={@dialog} />
      <div id="toast" role="status" phx-update="ignore"></div>
    </div>
    """
  end
end
