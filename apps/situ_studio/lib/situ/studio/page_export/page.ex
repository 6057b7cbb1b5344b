defmodule Situ.Studio.PageExport.Page do
  @moduledoc false
  # Renders the HTML of an exported page: the studio's panels, style sheet and scripts, and the data. The page's policy
  # forbids every request.
  use Situ.Live.Component
  import Situ.Studio.Web.Icons
  alias Situ.Live.Html
  alias Situ.Studio.PageExport
  alias Situ.Studio.Layout.Tree
  alias Situ.Studio.Web.{PageFrame, Panels}

  @policy "default-src 'none'; script-src 'unsafe-inline' blob:; style-src 'unsafe-inline'; " <>
            "img-src data: blob:; media-src blob:"

  @doc "Returns the HTML. `known` holds the facts about the streams that panels need."
  @spec render(PageExport.t(), map(), binary(), [String.t()]) :: binary()
  def render(export, known, data, notes) do
    assigns = %{
      export: export,
      known: known,
      layout: %{export.layout | tree: spread_tabs(export.layout.tree)},
      notes: notes,
      policy: @policy,
      time: Situ.Time.to_iso8601(export.from),
      length: Situ.Time.format_duration(export.to - export.from)
    }

    IO.iodata_to_binary([
      "<!DOCTYPE html>\n<html lang=\"en\"><head>",
      assigns |> page_head() |> Html.to_html(),
      "<style>#{read_asset("studio.css")}</style><script>#{read_asset("theme.js")}</script></head><body>",
      assigns |> page_body() |> Html.to_html(),
      packed_text("situ-data", data),
      space_code(export.layout),
      "<script>#{escape_script(read_asset("offline.js"))}</script>",
      "<i id=\"page-end\" hidden></i></body></html>\n"
    ])
  end

  defp packed_text(id, data),
    do:
      "<script type=\"text/plain\" id=\"#{id}\">#{data |> :zlib.gzip() |> Base.encode64()}</script>"

  # An exported page shows panels in tabs one above the other.
  defp spread_tabs(nil), do: nil

  defp spread_tabs(%Tree{way: way, parts: parts} = tree) do
    way = if way == :tabs, do: :column, else: way
    %{tree | way: way, parts: Enum.map(parts, &spread_tabs/1)}
  end

  # The drawing code of 3D panels is as large as the rest of the page, so only pages with such panels have it.
  defp space_code(layout) do
    if Enum.any?(layout.panels, &(&1.panel == :space)),
      do: packed_text("situ-space", read_asset("space.js")),
      else: ""
  end

  defp read_asset(name), do: File.read!(Application.app_dir(:situ_studio, "priv/static/" <> name))

  # "</script" in a string of the script would end it.
  defp escape_script(code), do: String.replace(code, "</script", "<\\/script")

  defp page_head(assigns) do
    ~H"""
    <meta charset="utf-8">
    <meta http-equiv="Content-Security-Policy" content={@policy}>
    <meta name="viewport" content="width=device-width, initial-scale=1">
    <meta name="generator" content="Situ">
    <title>{@export.title}</title>
    <link rel="icon" href="data:,">
    """
  end

  defp page_body(assigns) do
    ~H"""
    <div id="studio" class="studio offline">
      <.top_bar title={@export.title} />
      <main class="centre">
        <Panels.panel_stack layout={@layout} selected={nil} maximised={nil} known={@known}
            streams={map_size(@known.shapes)} />
      </main>
      <footer class="status">
        <span>{@time}, {@length}</span>
        <span>{count_streams(@layout)}</span>
        <details :if={@notes != []} class="notes">
          <summary>Reduced or left out ({length(@notes)})</summary>
          <ul><li :for={note <- @notes}>{note}</li></ul>
        </details>
        <span class="grow"></span>
        <span>exported with Situ</span>
        <button class="linkish" type="button" data-act="help"><kbd>?</kbd> keys</button>
      </footer>
    </div>
    <PageFrame.script_dialogs />
    """
  end

  defp count_streams(layout) do
    streams = for panel <- layout.panels, v <- panel.vis, uniq: true, do: v.stream
    if length(streams) == 1, do: "1 stream", else: "#{length(streams)} streams"
  end

  defp top_bar(assigns) do
    ~H"""
    <header class="topbar">
      <span class="brand"><.logo /><span>Situ</span></span>
      <h1 class="where" title={@title}>{@title}</h1>
      <span class="sep"></span>
      <PageFrame.play_button />
      <.tool_button act="repeat" icon={:repeat} title="Repeat (r)" />
      <.tool_button act="slower" icon={:slower} title="Half speed (,)" />
      <button id="speed" class="tool" type="button" data-act="normalSpeed"
        title="Playback speed; click for normal">1×</button>
      <.tool_button act="faster" icon={:faster} title="Double speed (.)" />
      <span class="sep"></span>
      <.tool_button act="zoomAll" icon={:fit} title="Zoom to fit (Ctrl+A)" />
      <.tool_button act="zoomSel" icon={:zoom} title="Zoom to the selection (Ctrl+S)" />
      <.tool_button act="clearSel" icon={:clear} title="Clear the selection (Alt+C)" />
      <.tool_button act="follow" icon={:follow} title="Move the cursor with the mouse (Alt+F)" />
      <span class="grow"></span>
      <PageFrame.time_display />
      <span class="sep"></span>
      <.tool_button act="theme" icon={:theme} title="Switch between dark and light (t)" />
      <.tool_button act="help" icon={:help} title="Keys (?)" />
    </header>
    """
  end
end
