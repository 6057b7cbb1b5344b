defmodule Situ.Studio.Web.ExperimentView do
  @moduledoc false
  # Serves the page of the experiments over a dataset: the sets of a run as a table and as charts, the worst sessions of
  # the selected set, comments, and the baseline. A click opens a session where a set and the baseline differ. The
  # address contains the run, the selected set, and how the sets are sorted and filtered.
  use Situ.Live.View
  import Situ.Studio.Web.Icons

  alias Situ.Experiment.{Baseline, Comments, ReportTable, RunRecord}
  alias Situ.Studio.{Catalog, Experiments}
  alias Situ.Studio.Experiments.{Axis, DifferencePage, SetList}
  alias Situ.Studio.Web.Experiment.{CurveChart, ParallelChart, SetDetails, SetParams, SetTable}
  alias Situ.Studio.Web.{PageFrame, Paths}

  @refresh_ms 2_000

  @impl true
  def mount(params, session, socket) do
    studio = session["studio"]
    id = params["id"] |> List.wrap() |> Enum.join("/")

    socket =
      assign(socket,
        studio: studio,
        id: id,
        page_title: "Experiments: #{id} - Situ Studio",
        read_only: Catalog.settings(studio).read_only or session["viewer"] == true,
        state: nil,
        axes: [],
        shown: SetParams.parse(params),
        stamp: nil,
        loading: nil,
        opening: nil,
        error: nil
      )

    with {:ok, %{kind: :dataset, path: file}} <- Catalog.fetch_item(studio, id) do
      if connected?(socket), do: Process.send_after(self(), :refresh, @refresh_ms)
      {:ok, assign(socket, file: file)}
    else
      {:ok, _} ->
        {:ok, assign(socket, error: Situ.Error.new(:not_found, "#{id} is not a dataset"))}

      {:error, error} ->
        {:ok, assign(socket, error: error)}
    end
  end

  @impl true
  def handle_params(_params, _uri, %{assigns: %{error: %{}}} = socket), do: {:noreply, socket}

  def handle_params(params, _uri, %{assigns: %{shown: before, state: state}} = socket) do
    shown = SetParams.parse(params)
    socket = assign(socket, shown: shown)
    reload? = state == nil or shown.run != before.run
    {:noreply, if(reload?, do: load_state(assign(socket, stamp: nil)), else: socket)}
  end

  # Intervals of many sets take seconds, so a task computes them. The files may change in the meantime.
  defp load_state(%{assigns: %{file: file, shown: shown, stamp: before}} = socket) do
    stamp = {shown.run, Experiments.stamp_files(file)}

    if not connected?(socket) or stamp == before or socket.assigns.loading == stamp do
      socket
    else
      page = self()

      {:ok, _} =
        Task.Supervisor.start_child(Situ.Studio.Tasks, fn ->
          send(page, {:loaded, stamp, Experiments.load_run(file, shown.run)})
        end)

      assign(socket, loading: stamp)
    end
  end

  @impl true
  def handle_info({:loaded, stamp, state}, %{assigns: %{loading: stamp}} = socket) do
    axes = if state.run, do: Axis.list_axes(state.rows, state.run), else: []
    {:noreply, assign(socket, state: state, axes: axes, stamp: stamp, loading: nil)}
  end

  def handle_info(:refresh, socket) do
    Process.send_after(self(), :refresh, @refresh_ms)
    socket = if killed?(socket.assigns.state), do: assign(socket, stamp: nil), else: socket
    {:noreply, if(socket.assigns.loading, do: socket, else: load_state(socket))}
  end

  def handle_info({:difference, ref, result}, %{assigns: %{opening: ref}} = socket) do
    socket = assign(socket, opening: nil)

    case result do
      {:ok, href} -> {:noreply, push_event(socket, "go", %{href: href})}
      {:error, error} -> {:noreply, show_toast(socket, Exception.message(error))}
    end
  end

  def handle_info(_, socket), do: {:noreply, socket}

  @impl true
  def handle_event(event, params, %{assigns: %{state: %{run: %{}}}} = socket),
    do: handle_shown(event, params, socket)

  def handle_event(_event, _params, socket), do: {:noreply, socket}

  # The address contains the state of the page.
  defp handle_shown(event, params, %{assigns: %{shown: shown, axes: axes}} = socket)
       when event in ["choose", "sort", "select", "brush", "clear"] do
    {:noreply, patch_address(socket, SetParams.apply_event(shown, {event, params}, axes))}
  end

  defp handle_shown("open", params, %{assigns: %{state: state}} = socket) do
    metric = Experiments.find_metric(state, text_param(params["metric"]))

    with %{} = row <- find_row(state, params["set"]),
         session when is_binary(session) <-
           params["session"] || Experiments.choose_session(state, row, metric) do
      {:noreply, open_difference(socket, row, session, metric)}
    else
      _ -> {:noreply, show_toast(socket, "This set has no results yet")}
    end
  end

  defp handle_shown(_event, _params, %{assigns: %{read_only: true}} = socket),
    do: {:noreply, show_toast(socket, "This studio is read-only")}

  defp handle_shown("promote", params, %{assigns: %{state: state}} = socket) do
    with %{number: number} <- find_row(state, params["set"]),
         {:ok, _} <- Baseline.promote_set(state.folder, state.run, number) do
      {:noreply, socket |> load_state() |> show_toast("Set #{number} is the baseline")}
    else
      {:error, error} -> {:noreply, show_toast(socket, Exception.message(error))}
      nil -> {:noreply, socket}
    end
  end

  defp handle_shown("comment", params, %{assigns: %{state: state}} = socket) do
    text = text_param(params["text"])
    by = text_param(params["by"]) |> String.trim() |> String.slice(0, 60)

    with %{number: number} <- find_row(state, params["set"]),
         :ok <- Comments.add_comment(state.folder, {state.run["run"], number}, text, by) do
      {:noreply, socket |> load_state() |> push_event("commented", %{})}
    else
      {:error, error} -> {:noreply, show_toast(socket, Exception.message(error))}
      nil -> {:noreply, socket}
    end
  end

  defp handle_shown(_event, _params, socket), do: {:noreply, socket}

  defp patch_address(socket, shown) do
    path = "/" <> Paths.experiments_path(socket.assigns.id)

    push_patch(socket, to: path <> "?" <> URI.encode_query(SetParams.encode(shown)), replace: true)
  end

  defp open_difference(%{assigns: %{state: state} = assigns} = socket, row, session, metric) do
    page = self()
    ref = make_ref()
    baseline = state.baseline && {state.baseline.folder, state.baseline.run, state.baseline.set}

    sets = %{
      set: {state.folder, state.run, row.number},
      baseline: baseline,
      metric: metric,
      read_only: assigns.read_only
    }

    place = {assigns.id, assigns.file, session}

    {:ok, _} =
      Task.Supervisor.start_child(Situ.Studio.Tasks, fn ->
        send(page, {:difference, ref, DifferencePage.open_address(assigns.studio, place, sets)})
      end)

    assign(socket, opening: ref)
  end

  defp find_row(state, number) when is_binary(number) or is_integer(number),
    do: Enum.find(state.rows, &(to_string(&1.number) == to_string(number)))

  defp find_row(_state, _number), do: nil

  # A killed run changes no file.
  defp killed?(%{status: "running", run: run}), do: RunRecord.status(run) == "killed"
  defp killed?(_state), do: false

  defp text_param(value), do: if(is_binary(value), do: value, else: "")
  defp show_toast(socket, text), do: push_event(socket, "toast", %{text: text})

  @impl true
  def render(%{error: %{}} = assigns), do: PageFrame.error_page(assigns)

  def render(%{state: nil} = assigns) do
    ~H"""
    <div id="experiments" class="experiments" phx-hook="Lists">
      <.top_bar id={@id} state={nil} />
      <main class="sets"><p class="hint" role="status">Reading the results …</p></main>
      <div id="toast" role="status" phx-update="ignore"></div>
    </div>
    """
  end

  def render(%{state: %{run: nil}} = assigns) do
    ~H"""
    <div id="experiments" class="experiments" phx-hook="Lists">
      <.top_bar id={@id} state={@state} />
      <main class="sets">
        <p :if={@state.runs == []} class="hint" role="status">No experiment has run over this dataset.
          <code>situ experiment run FILE.exs {Path.basename(@file)}</code> runs one; its results appear here.</p>
        <p :if={@state.runs != []} class="hint" role="status">There is no run with this name. Choose another one.</p>
      </main>
      <div id="toast" role="status" phx-update="ignore"></div>
    </div>
    """
  end

  def render(assigns) do
    %{state: state, shown: shown, axes: axes} = assigns
    rows = Enum.filter(state.rows, &Axis.within?(&1, axes, shown.ranges))
    metric = Experiments.find_metric(state, shown.metric)
    selected = (shown.set && find_row(state, shown.set)) || List.first(state.rows)
    over = Enum.filter(axes, & &1.parameter)

    assigns =
      assign(assigns,
        rows: SetList.sort_rows(rows, shown.sort),
        all: state.rows,
        metric: metric,
        selected: selected,
        over: over,
        # A curve over numbers shows more than one over names.
        curve:
          Enum.find(over, &(&1.parameter == shown.over)) ||
            Enum.find(over, List.first(over), & &1.low)
      )

    ~H"""
    <div id="experiments" class="experiments" phx-hook="Lists">
      <.top_bar id={@id} state={@state} />
      <main class="sets" aria-label="Sets of parameters">
        <.run_status state={@state} />
        <ParallelChart.parallel_chart :if={@axes != []} axes={@axes} rows={@rows} all={@all} ranges={@shown.ranges}
            selected={@selected} baseline={@state.baseline} />
        <SetTable.set_table rows={@rows} total={length(@all)} run={@state.run} sort={@shown.sort}
            selected={@selected} state={@state} opening={@opening != nil} />
      </main>
      <aside :if={@selected} class="set-side" aria-label="The selected set">
        <SetDetails.set_details row={@selected} state={@state} metric={@metric} read_only={@read_only} />
        <CurveChart.curve_chart :if={@curve} axis={@curve} over={@over} rows={@all} metric={@metric}
            metrics={@state.run["metrics"]} selected={@selected} />
        <SetDetails.comment_list row={@selected} state={@state} read_only={@read_only} />
      </aside>
      <div id="toast" role="status" phx-update="ignore"></div>
    </div>
    """
  end

  attr(:id, :string, required: true)
  attr(:state, :any, required: true)

  defp top_bar(assigns) do
    ~H"""
    <header class="topbar">
      <a class="brand" href="." title="All recordings"><.logo /><span>Situ</span></a>
      <h1 class="where"><a href={Paths.dataset_path(@id)} title="The dataset">{@id}</a>: experiments</h1>
      <form :if={@state && @state.runs != []} id="choose-run" phx-change="choose">
        <select class="select" name="run" aria-label="Run">
          <option :for={run <- Enum.reverse(@state.runs)} value={run.name}
              selected={@state.run != nil and run.name == @state.run["run"]}>{run.experiment} {run.name}</option>
        </select>
      </form>
      <span class="grow"></span>
      <a :if={@state && @state.run} class="btn" target="_blank"
          href={Paths.report_path(@id, @state.run["run"], :html)}>Report</a>
      <a :if={@state && @state.run} class="btn" href={Paths.report_path(@id, @state.run["run"], :markdown)}
          title="Save the tables as Markdown">Markdown</a>
      <.tool_button act="theme" icon={:theme} title="Switch between dark and light (t)" />
    </header>
    """
  end

  attr(:state, :any, required: true)

  defp run_status(assigns) do
    ~H"""
    <p class="hint run-status" role="status">
      <progress :if={@state.status == "running"} max={max(@state.progress.total, 1)} value={@state.progress.done}
          aria-label="Progress of the run"></progress>
      {describe_status(@state)}
    </p>
    """
  end

  defp describe_status(%{progress: progress, run: run, status: status} = state) do
    sets =
      "#{length(run["sets"])} sets, #{length(run["sessions"])} sessions, method #{run["method"]}"

    failures = if progress.failed > 0, do: ", #{progress.failed} failed", else: ""
    nodes = if run["nodes"], do: ", #{map_size(run["nodes"])} nodes of a cluster", else: ""
    machines = for text <- ReportTable.describe_machines(state.rows, run), do: " #{text}."

    "#{describe_state(status, progress)}#{failures}. #{sets}#{nodes}. " <>
      "#{describe_baseline(state.baseline, run)}#{machines}"
  end

  defp describe_state("running", progress) do
    left = progress.left_s && Situ.Time.format_duration(round(progress.left_s) * 1_000_000_000)

    "Running: #{progress.done} of #{progress.total} results" <>
      if(left, do: ", about #{left} left", else: "")
  end

  defp describe_state(status, progress),
    do: "#{String.capitalize(status)}: #{progress.done} of #{progress.total} results"

  defp describe_baseline(nil, _run), do: ""

  defp describe_baseline(%{promoted?: false, set: set}, _run),
    do: "Compared with the best set, #{set}: no set is the baseline yet."

  defp describe_baseline(%{set: set, run: %{"run" => name}}, %{"run" => name}),
    do: "Compared with the baseline, set #{set}."

  defp describe_baseline(%{set: set, run: run}, _run),
    do: "Compared with the baseline, set #{set} of run #{run["run"]}."
end
