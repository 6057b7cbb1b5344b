defmodule Situ.Studio.Web.PageFrame do
  @moduledoc false
  # Renders the frame around the panels: toolbar, time display, status bar and dialogs.
  use Situ.Live.Component
  import Situ.Studio.Web.Icons
  alias Situ.Studio.Layout

  @doc false
  def page_layout(assigns) do
    ~H"""
    <html lang="en">
      <head>
        <meta charset="utf-8">
        <meta name="viewport" content="width=device-width, initial-scale=1">
        <title>{@page_title || "Situ Studio"}</title>
        <base href={@base}>
        <link rel="icon" href="assets/favicon.svg">
        <link rel="stylesheet" href="assets/studio.css">
        <script src="assets/theme.js"></script>
        <script defer src="assets/studio.js"></script>
      </head>
      <body>{@inner_content}<i id="page-end" hidden></i></body>
    </html>
    """
  end

  @doc "Renders the page of an item that cannot be shown, with the error's what, why and fix."
  @spec error_page(map()) :: Situ.Live.Rendered.t()
  def error_page(assigns) do
    ~H"""
    <main class="message">
      <div role="alert">
        <h1>{capitalize_first(@error.what)}</h1>
        <p :if={@error.why}>{to_sentence(@error.why)}</p>
        <p :if={@error.fix}>{to_sentence(@error.fix)}</p>
      </div>
      <p><a class="btn" href=".">All recordings</a></p>
    </main>
    """
  end

  # Error texts start in lower case and have no full stop, so that they can be joined into one line.
  defp to_sentence(text),
    do: capitalize_first(text) <> if(String.ends_with?(text, [".", "?", "!"]), do: "", else: ".")

  defp capitalize_first(<<first::utf8, rest::binary>>), do: String.upcase(<<first::utf8>>) <> rest
  defp capitalize_first(text), do: text

  attr(:damage, :list, required: true)
  attr(:path, :string, required: true)

  @doc "Renders a notice that a recording is damaged, with the commands that list the damage and repair it."
  @spec damage_notice(map()) :: Situ.Live.Rendered.t()
  def damage_notice(assigns) do
    ~H"""
    <div class="damage" role="alert">
      <b>This recording is damaged.</b>
      <span :for={what <- Enum.take(@damage, 3)}>{what}.</span>
      <span :if={length(@damage) > 3}>{length(@damage) - 3} more.</span>
      <span><code>situ store verify '{@path}'</code> lists the damage,
        <code>situ store repair '{@path}'</code> saves everything that can still be read.</span>
    </div>
    """
  end

  attr(:title, :string, required: true)
  attr(:layouts, :list, required: true)
  attr(:layout, :string, required: true)
  attr(:changed, :boolean, required: true)
  attr(:read_only, :boolean, required: true)
  attr(:pipeline, :string, default: nil)
  attr(:export, :boolean, default: false)
  attr(:annotate, :boolean, default: false)
  attr(:session, :boolean, default: false)

  @doc false
  def top_bar(assigns) do
    ~H"""
    <header class="topbar">
      <a class="brand" href="." title="All recordings"><.logo /><span>Situ</span></a>
      <.tool_button act="left" icon={:streams} title="Show or hide the streams (s)" />
      <.tool_button :if={@session} act="previousSession" icon={:up} title="Previous session (Alt+PageUp)" />
      <h1 class="where" title={@title}>{@title}</h1>
      <.tool_button :if={@session} act="nextSession" icon={:down} title="Next session (Alt+PageDown)" />
      <span class="sep"></span>
      <div id="toolbar" phx-update="ignore" style="display: contents">
        <.play_button />
        <.tool_button act="togglePlaySel" icon={:selection} title="Play the selection (Ctrl+Space)" />
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
        <span class="sep"></span>
        <button class="tool live" type="button" data-act="live" title="Follow the live data (l)"
            disabled>LIVE</button>
        <span class="grow"></span>
        <.time_display />
      </div>
      <span class="sep"></span>
      <form id="layout-pick" phx-change="layout_pick" phx-auto-recover="ignore">
        <select class="select" name="layout" aria-label="Layout" title="Layout">
          <option :for={name <- @layouts} value={name}
              selected={name == @layout}>{name}{if @changed and name == @layout, do: " *"}</option>
        </select>
      </form>
      <button :if={not @read_only} class="tool save" type="button" phx-click="layout_dialog"
          title="Save the layout" aria-label="Save the layout"><.icon name={:save} /></button>
      <.tool_button :if={@export} act="export" icon={:export} title="Save the selection as a recording (Ctrl+E)" />
      <a :if={@pipeline} class="tool graph-link" href={@pipeline} title="The pipeline's graph"><.icon
          name={:pipeline} /></a>
      <.tool_button :if={@annotate} act="annotate" icon={:mark} title="Annotate (a)" />
      <.tool_button act="undo" icon={:undo} title="Undo (Ctrl+Z)" />
      <.tool_button act="redo" icon={:redo} title="Redo (Ctrl+Shift+Z)" />
      <.tool_button act="beside" icon={:beside} title="Images next to the timelines, or above them (b)" />
      <.tool_button act="copyLink" icon={:link} title="Copy link to this view" />
      <.tool_button act="right" icon={:side} title="Show or hide the properties (p)" />
      <.tool_button act="theme" icon={:theme} title="Switch between dark and light (t)" />
      <.tool_button act="help" icon={:help} title="Keys (?)" />
      <button id="more" class="tool" type="button" phx-hook="More" phx-update="ignore" data-more
          title="More tools" aria-label="More tools" aria-haspopup="menu"><.icon name={:more} /></button>
    </header>
    """
  end

  @doc false
  def time_display(assigns) do
    ~H"""
    <button class="timing" type="button" data-act="timing"
        title="Switch between clock time, time since the start, and time since the start of the selection">
      <div class="c"><span id="t-from">Cursor</span><b id="t-cursor">–</b></div>
      <div class="a"><span>Selection from</span><b id="t-start">–</b></div>
      <div class="e"><span>to</span><b id="t-end">–</b></div>
      <div class="len"><span id="t-length-of">length</span><b id="t-length">–</b></div>
    </button>
    """
  end

  @doc false
  def play_button(assigns) do
    ~H"""
    <button class="tool play" type="button" data-act="togglePlay" title="Play or stop (Space)"
        aria-label="Play or stop" aria-pressed="false"><.icon name={:play} class="i-play" /><.icon
        name={:stop} class="i-stop" /></button>
    """
  end

  attr(:infos, :list, required: true)
  attr(:layout, :any, required: true)
  attr(:source, :string, required: true)
  attr(:read_only, :boolean, required: true)
  attr(:viewer, :boolean, default: false)
  attr(:snap, :any, default: nil)

  @doc false
  def status_bar(assigns) do
    assigns = assign(assigns, left_out: length(Layout.left_out(assigns.layout, assigns.infos)))

    ~H"""
    <footer class="status">
      <span><i class="dot"></i><span id="connection" phx-update="ignore">connecting</span></span>
      <span>{@source}</span>
      <span>{count_text(length(@infos))}</span>
      <span :if={@left_out > 0} title="Double-click a stream in the list, or drag it, to show it"
          >{@left_out} not shown</span>
      <span :if={@viewer} class="viewer" title="You opened a view-only link">view only</span>
      <span :if={@read_only and not @viewer}>read-only</span>
      <button :if={@snap} class="snapped" type="button" phx-click="snap" phx-value-stream={@snap}
          title="Release the cursor">cursor snaps to {@snap} ×</button>
      <span class="grow"></span>
      <span id="together" phx-update="ignore"></span>
      <a class="linkish" href="settings" data-settings><kbd>o</kbd> settings</a>
      <button class="linkish" type="button" data-act="help"><kbd>?</kbd> keys</button>
      <button class="linkish" type="button" data-act="palette"><kbd>Ctrl+K</kbd> commands</button>
      <span id="tempo" phx-update="ignore"></span>
    </footer>
    """
  end

  defp count_text(1), do: "1 stream"
  defp count_text(n), do: "#{n} streams"

  @doc false
  def script_dialogs(assigns) do
    ~H"""
    <span id="channel" phx-hook="Channel" hidden></span>
    <div id="dialogs" phx-update="ignore">
      <dialog id="goto" aria-label="Go to time">
        <form method="dialog">
          <h3>Go to time</h3>
          <input name="time" autocomplete="off" placeholder="1:23.5, 83.5 s, 250 ms, 2026-01-31T12:34:56Z"
              aria-label="Time">
          <div class="error" role="alert"></div>
        </form>
      </dialog>
      <dialog id="help" aria-label="Keys"><h3>Keyboard shortcuts</h3><dl tabindex="0"></dl>
        <p
            class="hint">
          Mouse on a timeline: move = cursor, drag = pan, wheel = zoom, Shift+drag = select,
          Shift+click and Shift+right click = start and end of the selection.
        </p>
      </dialog>
      <dialog id="palette" aria-label="Commands"><input placeholder="Command or stream" autocomplete="off"
          aria-label="Command or stream"><ul role="listbox"></ul></dialog>
      <div id="toast" role="status"></div>
      <div id="banner" role="alert"></div>
    </div>
    """
  end
end
