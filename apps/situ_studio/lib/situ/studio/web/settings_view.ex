defmodule Situ.Studio.Web.SettingsView do
  @moduledoc false
  # Serves the settings page, with the settings that the studio stores for everybody and the settings that this browser
  # stores.
  use Situ.Live.View
  import Situ.Studio.Web.Icons

  alias Situ.Studio.Alerts.Rule
  alias Situ.Studio.{Catalog, StreamTotals, Layout, Layouts, Settings}

  @keep [
    by_hand: "only when saved manually",
    at_once: "after every change",
    ask: "manually; ask before leaving a changed layout"
  ]

  @impl true
  def mount(_params, session, socket) do
    known = Catalog.settings(session["studio"])
    names = [Layout.Auto.layout_name() | Layouts.list_names(known.layouts)]

    {:ok,
     assign(socket,
       page_title: "Settings - Situ Studio",
       folder: known.layouts,
       read_only: known.read_only or session["viewer"] == true,
       settings: Settings.load(known.layouts),
       problems: Layouts.list_problems(known.layouts),
       names: Enum.uniq(names)
     )}
  end

  @impl true
  # If a line is not a rule, the error names it and nothing is saved.
  def handle_event("alerts", %{"alerts" => text}, %{assigns: %{read_only: false}} = socket)
      when is_binary(text) do
    case Rule.parse_rules(text) do
      {:ok, _} -> handle_event("settings", %{"alerts" => text}, socket)
      {:error, error} -> {:noreply, show_toast(socket, Exception.message(error))}
    end
  end

  def handle_event("settings", params, %{assigns: %{read_only: false}} = socket) do
    settings = Settings.put_values(socket.assigns.settings, params)

    case Settings.save(socket.assigns.folder, settings, socket.assigns.settings) do
      :ok -> {:noreply, socket |> assign(settings: settings) |> show_toast("Settings saved")}
      {:error, error} -> {:noreply, show_toast(socket, Exception.message(error))}
    end
  end

  def handle_event(_event, _params, socket), do: {:noreply, socket}

  defp show_toast(socket, text), do: push_event(socket, "toast", %{text: text})

  @impl true
  def render(assigns) do
    assigns = assign(assigns, keep: @keep, info: StreamTotals.list_choices())

    ~H"""
    <main class="home settings" id="settings" phx-hook="Lists">
      <h1><a href="." title="All recordings" aria-label="All recordings"><.logo /></a><span>Settings</span>
        <a id="settings-back" class="btn" href="." phx-hook="Back" phx-update="ignore">Back</a></h1>
      <section aria-label="Settings of this studio">
        <h2>This studio, for everybody</h2>
        <p :if={@read_only} class="hint">This studio is read-only, so its settings cannot be changed.</p>
        <form id="server-settings" phx-change="settings" phx-submit="settings">
          <div class="field"><label for="setting-layout">Open recordings with the layout</label>
            <select id="setting-layout" name="layout" disabled={@read_only}>
              <option :for={name <- @names} value={name} selected={name == @settings.layout}>{name}</option>
            </select></div>
          <div class="field"><label for="setting-keep">Save named layouts</label>
            <select id="setting-keep" name="keep" disabled={@read_only}>
              <option :for={{value, text} <- @keep} value={value}
                  selected={value == @settings.keep}>{text}</option>
            </select></div>
          <div class="field"><label for="setting-info">Show next to stream names</label>
            <select id="setting-info" name="info" disabled={@read_only}>
              <option :for={{value, text} <- @info} value={value}
                  selected={value == @settings.info}>{text}</option>
            </select></div>
        </form>
        <p :for={{path, error} <- @problems} class="hint">Cannot load layout {Path.basename(path)}: {error.what}.</p>
        <form id="alert-settings" phx-submit="alerts">
          <div class="field"><label for="setting-alerts">Alerts of running pipelines, one per line: a name, a colon, and
            an expression over streams and statistics</label>
            <textarea id="setting-alerts" name="alerts" rows="4" spellcheck="false" disabled={@read_only}
                placeholder="busy: `queue(Slow.Heavy)` > 100 or `busy(Slow.Heavy)` > 90"
                >{@settings.alerts}</textarea></div>
          <p :if={not @read_only} class="choices"><button class="btn" type="submit">Save alerts</button></p>
        </form>
      </section>
      <section aria-label="Settings of this browser">
        <h2>This browser</h2>
        <div id="browser-settings" phx-hook="BrowserSettings" phx-update="ignore"></div>
      </section>
      <div id="toast" role="status" phx-update="ignore"></div>
    </main>
    """
  end
end
