defmodule Situ.Studio.Web.Dataset.Components do
  @moduledoc false
  # Renders the components of a dataset's page: the top bar, the tree, the properties and the batch runs.
  use Situ.Live.Component
  import Situ.Studio.Web.Icons
  import Situ.Studio.Web.TimeLabels

  alias Situ.Dataset.{Derivation.Report, Session}
  alias Situ.Studio.BatchRuns.Run
  alias Situ.Studio.Datasets.{Summary, DatasetRef}
  alias Situ.Studio.Web.Dataset.{RowMenu, Rows}
  alias Situ.Studio.StreamTotals
  alias Situ.Studio.Web.{Paths, Sidebars, StreamProps}

  attr(:title, :string, required: true)
  attr(:file, :string, required: true)
  attr(:read_only, :boolean, required: true)
  attr(:kept, :boolean, required: true)
  attr(:experiments, :any, required: true)

  @doc false
  def top_bar(assigns) do
    ~H"""
    <header class="topbar">
      <a class="brand" href="." title="All recordings"><.logo /><span>Situ</span></a>
      <h1 class="where" title={@file}>{@title}</h1>
      <span class="grow"></span>
      <span :if={@read_only} class="hint">read-only</span>
      <a :if={@experiments} id="experiments-link" class="btn" href={@experiments}
          title="Show the experiments over this dataset">Experiments</a>
      <button :if={not @kept and not @read_only} class="btn" type="button" phx-click="ask" phx-value-what="copy"
          phx-value-path="[]"
          title="This file format is read-only; save a copy to keep your changes">Save a copy…</button>
      <button class="btn" type="button" phx-click="find_open"
          title="Find the times in all sessions when an expression is true">Find times…</button>
      <button :if={@kept and not @read_only} class="btn" type="button" phx-click="history_dialog"
          title="Show who changed the dataset, undo, and restore earlier versions">History…</button>
      <.tool_button act="theme" icon={:theme} title="Switch between dark and light (t)" />
    </header>
    """
  end

  attr(:dataset, :any, required: true)
  attr(:facts, :map, required: true)
  attr(:open, :any, required: true)
  attr(:query, :string, required: true)
  attr(:info, :atom, required: true)
  attr(:selected, :list, required: true)
  attr(:id, :string, required: true)
  attr(:tasks, :list, required: true)
  attr(:read_only, :boolean, required: true)

  @doc false
  def session_tree(assigns) do
    rows = Rows.visible_rows(assigns.dataset, assigns.facts, assigns.open, assigns.query)
    found = Enum.count(rows, &(&1.kind == :session))
    assigns = assign(assigns, rows: rows, found: found)

    ~H"""
    <main class="dataset-tree" aria-label="Sessions">
      <form class="search" phx-change="search" phx-submit="search" id="search-form">
        <input id="search" name="query" value={@query} autocomplete="off" phx-debounce="80"
            placeholder="Search sessions, tags, metadata, recordings and streams  /"
            aria-label="Search sessions, tags, metadata, recordings and streams">
        <Sidebars.info_select info={@info} />
        <button class="mini" type="button" phx-click="fold_all" title="Fold all" aria-label="Fold all">⊟</button>
        <button class="mini" type="button" phx-click="unfold_all" title="Unfold all"
            aria-label="Unfold all">⊞</button>
      </form>
      <p :if={@query != ""} class="hint found" role="status">{@found} of {length(@dataset.sessions)} sessions</p>
      <div id="tree" class="tree" role="tree" phx-hook="Tree" aria-label="Sessions">
        <div :for={row <- @rows} :key={row_id(row)} id={row_id(row)} role="treeitem" tabindex="0"
            class={["node", to_string(row.kind), row.path == @selected && "selected"]}
            aria-expanded={row.open? != nil && to_string(row.open?)} aria-level={length(row.path) + 1}
            aria-selected={to_string(row.path == @selected)}
            data-items={RowMenu.encode_menu(row, %{id: @id, tasks: @tasks, read_only: @read_only})}
            style={"padding-left: #{length(row.path) * 18}px"}>
          <button :if={row.open? != nil} class="fold" type="button" tabindex="-1" phx-click="toggle"
              phx-value-path={encode_path(row)}
              aria-label={"fold " <> row.label}>{if row.open?, do: "▾", else: "▸"}</button>
          <span :if={row.open? == nil} class="fold"></span>
          <img :if={row.kind == :session and row.facts.streams != []} class="thumb" alt="" loading="lazy" width="64"
              height="36" src={Paths.thumbnail_path(DatasetRef.build_id(@id, row.path))}>
          <button class="name" type="button" tabindex="-1" phx-click="select" phx-value-path={encode_path(row)}
              title={row.label}>{row.label}</button>
          <span :for={tag <- row.tags} class="tag">{tag}</span>
          <span :if={row.trouble} class="trouble" title={row.trouble}>{row.trouble}</span>
          <.figure_label :if={row.figures} choice={@info} figures={row.figures} />
          <span :if={row.figures == nil} class="info">…</span>
          <a :if={row.kind in [:session, :partition]} class="add" tabindex="-1"
              href={Paths.source_path(DatasetRef.build_id(@id, row.path))}
              title="Open (Enter)" aria-label={"open " <> row.label}>↗</a>
          <button class="dots" type="button" tabindex="-1" aria-haspopup="menu"
              aria-label={"menu of " <> row.label}>⋯</button>
        </div>
        <p :if={@dataset.sessions == []} class="hint empty">No sessions yet. Add one from the dataset menu.</p>
      </div>
    </main>
    """
  end

  defp row_id(row), do: "row-" <> Integer.to_string(:erlang.phash2(row.path, 4_294_967_296))
  defp encode_path(row), do: Situ.JSON.encode(row.path)

  attr(:dataset, :any, required: true)
  attr(:facts, :map, required: true)
  attr(:selected, :list, required: true)
  attr(:id, :string, required: true)
  attr(:read_only, :boolean, required: true)
  attr(:runs, :list, required: true)
  attr(:left, :list, required: true)
  attr(:now, :integer, required: true)

  @doc false
  def dataset_sidebar(assigns) do
    assigns = assign(assigns, :shown, selected_properties(assigns))

    ~H"""
    <aside class="dataset-side" aria-label="Properties and runs">
      <.run_list :if={@runs != [] or @left != []} runs={@runs} left={@left} now={@now} read_only={@read_only} />
      <.properties_form :if={@shown} id={"props-#{:erlang.phash2(@selected)}"} read_only={@read_only}
          {Map.take(@shown, [:title, :rows, :name, :tags, :metadata, :stream])} />
      <p :if={@shown == nil} class="hint">The selected item is no longer in the dataset.</p>
    </aside>
    """
  end

  defp selected_properties(%{dataset: dataset, selected: []} = assigns) do
    facts = for s <- dataset.sessions, p <- s.partitions, f = assigns.facts[p.path], do: f

    sums =
      for s <- dataset.sessions,
          do: Summary.sum_figures(for p <- s.partitions, f = assigns.facts[p.path], do: f)

    length = facts |> Summary.sum_figures() |> StreamTotals.add_lengths(sums)

    # Weeks may pass between the first and the last message, so the total duration is the sum over the sessions.
    rows =
      [
        {"Sessions", length(dataset.sessions)},
        {"Total duration", StreamTotals.format_figure(:duration, length)}
      ] ++
        Enum.map(recording_rows(Summary.merge_facts(facts)), &relabel_duration/1) ++
        [{"File", dataset.file}]

    build_properties(dataset.name, rows, %{
      name: dataset.name,
      tags: dataset.tags,
      metadata: dataset.metadata
    })
  end

  defp selected_properties(%{dataset: dataset, selected: [name | rest]} = assigns) do
    with %Session{} = session <- Enum.find(dataset.sessions, &(&1.name == name)),
         do: session_properties(session, rest, assigns.facts)
  end

  defp session_properties(session, [], all) do
    facts = for p <- session.partitions, f = all[p.path], do: f

    rows = [
      {"Recordings", length(session.partitions)} | recording_rows(Summary.merge_facts(facts))
    ]

    build_properties(session.name, rows, %{tags: session.tags, metadata: session.metadata})
  end

  defp session_properties(session, [name | stream], all) do
    with %{} = partition <- Enum.find(session.partitions, &(&1.name == name)) do
      facts = all[partition.path] || %Summary{}
      shown = Enum.find(facts.streams, &([&1.name] == stream))

      if shown,
        do: build_properties(shown.name, stream_rows(shown), %{stream: true}),
        else:
          build_properties(name, recording_rows(facts) ++ partition_rows(partition, facts), %{
            metadata: partition.metadata
          })
    end
  end

  defp build_properties(title, rows, more) do
    rows = Enum.reject(rows, fn {_, value} -> value in [nil, ""] end)

    Map.merge(
      %{title: title, rows: rows, name: nil, tags: nil, metadata: %{}, stream: false},
      more
    )
  end

  defp recording_rows(facts) do
    [
      {"Duration", Summary.format_duration(facts)},
      {"From", time_value(facts.from)},
      {"To", time_value(facts.to)},
      {"Streams", length(facts.streams)},
      {"Messages", facts.streams |> Enum.map(& &1.count) |> Enum.sum()},
      {"Size", StreamTotals.format_bytes(facts.size)}
    ]
  end

  defp partition_rows(partition, facts) do
    [
      {"Recording", partition.path},
      {"Reader", partition.reader},
      {"Made by", describe_origin(partition.extra["provenance"])},
      {"Checksum", partition.checksum},
      {"Trouble", facts.error && Exception.message(facts.error)},
      {"Live", facts.live && "being recorded"}
    ]
    |> Enum.filter(&elem(&1, 1))
  end

  # A dataset file can contain any JSON here.
  defp describe_origin(%{"task" => task, "at" => at, "options" => %{} = options})
       when is_binary(task) and is_binary(at) do
    shown =
      Enum.map_join(options, ", ", fn {name, value} -> "#{name}: #{Situ.JSON.encode(value)}" end)

    if shown == "", do: "#{task}, #{at}", else: "#{task} (#{shown}), #{at}"
  end

  defp describe_origin(_), do: nil

  defp stream_rows(stream) do
    [
      {"Type", stream.type},
      {"Messages", stream.count},
      {"Size", StreamTotals.format_bytes(stream.bytes)},
      {"Rate", StreamTotals.format_figure(:rate, StreamTotals.sum_streams([stream]))},
      {"First", time_value(stream.first)},
      {"Last", time_value(stream.last)},
      {"Latency, mean", stream.latency && StreamTotals.format_latency(stream.latency)}
      | stream.details
    ]
  end

  defp relabel_duration({"Duration", value}), do: {"First to last message", value}
  defp relabel_duration(row), do: row

  defp time_value(nil), do: nil
  defp time_value(ns), do: {:time, ns}

  attr(:id, :string, required: true)
  attr(:read_only, :boolean, required: true)
  attr(:title, :string, required: true)
  attr(:rows, :list, required: true)
  attr(:name, :any, required: true)
  attr(:tags, :any, required: true)
  attr(:metadata, :map, required: true)
  attr(:stream, :boolean, required: true)

  defp properties_form(assigns) do
    ~H"""
    <section class="props">
      <h2>{@title}</h2>
      <dl>
        <div :for={{name, value} <- @rows} style="display: contents"><dt>{name}</dt><dd><StreamProps.detail_value
            value={value} /></dd></div>
      </dl>
      <form :if={not @stream} id={@id} class="metadata" phx-submit="save_properties">
        <label :if={@name}>Name <input name="name" value={@name} maxlength="200" disabled={@read_only}></label>
        <label :if={@tags}>Tags, separated by commas <input name="tags" value={Enum.join(@tags, ", ")}
            disabled={@read_only} placeholder="pilot, english"></label>
        <label>Metadata, one NAME: VALUE per line
          <textarea name="metadata" rows="6" disabled={@read_only}
              placeholder="participant: P07">{Rows.format_metadata(@metadata)}</textarea></label>
        <button :if={not @read_only} class="btn primary" type="submit">Save</button>
      </form>
    </section>
    """
  end

  attr(:runs, :list, required: true)
  attr(:left, :list, required: true)
  attr(:now, :integer, required: true)
  attr(:read_only, :boolean, required: true)

  defp run_list(assigns) do
    ~H"""
    <section class="runs" aria-label="Batch runs">
      <h2>Batch runs</h2>
      <div :for={left <- @left} :key={left.task <> to_string(left.output)} class="run left">
        <div class="head"><b>{left.task}</b><span :if={left.output}> to {left.output}</span></div>
        <p class="hint">Interrupted when its studio stopped, with {length(left.sessions)}
          {if length(left.sessions) == 1, do: "session", else: "sessions"}. Finished sessions are kept.</p>
        <div :if={not @read_only} class="choices">
          <button class="btn primary" type="button" phx-click="run_continue"
              phx-value-output={to_string(left.output)}>Continue</button>
          <button class="btn" type="button" phx-click="run_leave"
              phx-value-output={to_string(left.output)}>Discard</button>
        </div>
      </div>
      <div :for={run <- @runs} :key={run.id} id={"run-#{run.id}"} class={["run", to_string(run.status)]}>
        <div class="head"><b>{run.task}</b><span :if={run.output}> to {run.output}</span>
          <span class="grow"></span>
          <button :if={run.status == :running and not @read_only} class="btn" type="button" phx-click="run_cancel"
              phx-value-run={run.id}>Cancel</button></div>
        <progress :if={run.status == :running} max="1" value={run.progress.done}
            aria-label={"progress of " <> run.task}></progress>
        <p class="hint" role="status">{describe_run(run, @now)}</p>
        <ul :if={list_failures(run) != []} class="failures">
          <li :for={{session, error} <- list_failures(run)}><b>{session}</b>: {error}</li>
        </ul>
      </div>
    </section>
    """
  end

  defp describe_run(%Run{status: :running} = run, now) do
    finished = Map.get(run.progress, :finished, 0)
    left = Run.remaining_ms(run, now)

    "#{round(100 * run.progress.done)} %, #{finished} of #{length(run.sessions)} sessions, " <>
      "#{format_ms(Run.elapsed_ms(run, now))} so far" <>
      if(left, do: ", about #{format_ms(left)} left", else: "")
  end

  defp describe_run(%Run{error: %{} = error}, _), do: Exception.message(error)

  defp describe_run(%Run{report: report} = run, now) do
    done = Enum.count(report.results, &(&1.status in [:done, :kept]))
    failed = length(Report.failures(report))

    "#{status_text(run.status)} after #{format_ms(Run.elapsed_ms(run, now))}: " <>
      "#{done} of #{length(run.sessions)} sessions" <>
      if(failed > 0, do: ", #{failed} failed", else: "")
  end

  defp status_text(:done), do: "Done"
  defp status_text(:cancelled), do: "Cancelled"
  defp status_text(:failed), do: "Ended with failures"

  defp format_ms(ms), do: Situ.Time.format_duration(Situ.Time.ms(ms))

  defp list_failures(%Run{report: nil}), do: []

  defp list_failures(%Run{report: report}),
    do: for({session, error} <- Report.failures(report), do: {session, Exception.message(error)})
end
