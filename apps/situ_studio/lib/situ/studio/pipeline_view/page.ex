defmodule Situ.Studio.PipelineView.Page do
  @moduledoc false
  # Renders the page of a pipeline's graph: toolbar, graph, slider of recorded moments, details and status line.
  use Situ.Live.Component
  import Situ.Studio.Web.Icons

  alias Situ.Studio.PipelineView.{Details, Highlighting, Stats, Tracing}
  alias Situ.Studio.Web.{Paths, AlertBox, PageFrame}

  @spec render(map()) :: Situ.Live.Rendered.t()
  def render(%{error: %{}} = assigns), do: PageFrame.error_page(assigns)

  def render(assigns) do
    ~H"""
    <div class="studio pipeline" id="pipeline" data-selected={@selected}>
      <header class="topbar">
        <a class="brand" href="." title="All recordings"><.logo /><span>Situ</span></a>
        <h1 class="where"><a href={Paths.source_path(@id)} title="Streams of this pipeline">{@id}</a></h1>
        <span class="sep"></span>
        <span class={["state", @snapshot.state]}>{@snapshot.state}</span>
        <span class="dim">{round(@snapshot.progress * 100)} %</span>
        <span class="sep"></span>
        <form id="heat" phx-change="heat">
          <label>Colour by
            <select class="select" name="heat">
              <option value="none" selected={@heat == "none"}>nothing</option>
              <option :for={s <- Stats.list_stats(:edge) ++ Stats.list_stats(:node)} value={s.id}
                  selected={s.id == @heat}>{s.name}</option>
            </select>
          </label>
        </form>
        <form id="mark" phx-change="mark">
          <label>Highlight
            <select class="select" name="mark">
              <option :for={{id, name} <- Highlighting.highlight_choices()}
                  value={id} selected={id == @mark}>{name}</option>
            </select>
          </label>
          <select class="select" name="way" aria-label="Direction" title="Direction">
            <option :for={{id, name} <- Highlighting.graph_directions()}
                value={id} selected={id == @way}>{name}</option>
          </select>
        </form>
        <span class="grow"></span>
        <button :if={@snapshot.scopes != []} class="tool" type="button" phx-click="fold_all">Fold all</button>
        <button :if={@snapshot.scopes != []} class="tool" type="button" phx-click="unfold_all">Unfold all</button>
        <button class="tool" type="button" data-graph="fit" title="View everything (f)"><.icon name={:fit} /></button>
        <a class="tool" href={Paths.source_path(@id)} title="Streams of this pipeline">Streams</a>
      </header>
      <main class="centre">
        <AlertBox.alert_list alerts={@alerts} />
        <div id="graph" class="graph" phx-hook="PipelineGraph" phx-update="ignore" tabindex="0" role="img"
            aria-label="Graph of the pipeline"></div>
        <form :if={@moments != []} id="moments" class="moments" phx-change="at">
          <input type="range" name="moment" min="0" max={length(@moments) - 1} value={moment_index(@moments, @at)}
              aria-label="Moment" phx-debounce="30">
          <span class="dim">{format_clock(@at)}</span>
        </form>
      </main>
      <aside class="right">
        <Tracing.trace_panel :if={@trace} trace={@trace} />
        <Tracing.trace_form :if={@live} error={@untraced} />
        <Details.details_panel live={@live} snapshot={@snapshot} sample={@sample} selected={@selected} folded={@folded}
            messages={@messages} heat={@heat} plots={@plots} />
      </aside>
      <footer class="status">
        <span><i class="dot"></i>{status_text(@live, @feed)}</span>
        <span>{format_count(@snapshot.nodes, "component", "components")}</span>
        <span>{format_count(@snapshot.edges, "connection", "connections")}</span>
        <span>{format_count(@snapshot.processes, "process", "processes")}</span>
        <span class="grow"></span>
        <span>click: details · double click: fold · wheel: zoom · drag: pan</span>
      </footer>
    </div>
    """
  end

  defp status_text(true, _), do: "running now"
  defp status_text(false, {:live, _}), do: "ended: showing the last state"
  defp status_text(false, _), do: "recorded"

  defp moment_index(moments, at), do: max(0, Enum.count(moments, &(&1 <= at)) - 1)

  defp format_clock(nil), do: ""
  defp format_clock(ns), do: ns |> Situ.Time.to_iso8601() |> String.slice(11, 12)

  defp format_count([_], one, _many), do: "1 #{one}"
  defp format_count(list, _one, many), do: "#{length(list)} #{many}"
end
