defmodule Situ.Studio.Web.HomeView do
  @moduledoc false
  # The list of what can be looked at.
  use Situ.Live.View
  import Situ.Studio.Web.Icons
  alias Situ.Studio.Catalog

  @refresh_ms 2_000

  @impl true
  def mount(_params, session, socket) do
    if connected?(socket), do: Process.send_after(self(), :refresh, @refresh_ms)
    {:ok, socket |> assign(studio: session["studio"], page_title: "Situ Studio") |> load()}
  end

  @impl true
  def handle_info(:refresh, socket) do
    Process.send_after(self(), :refresh, @refresh_ms)
    {:noreply, load(socket)}
  end

  def handle_info(_, socket), do: {:noreply, socket}

  # A page of another version may send what this one does not know.
  @impl true
  def handle_event(_event, _params, socket), do: {:noreply, socket}

  defp load(socket), do: assign(socket, items: Catalog.list(socket.assigns.studio))

  @impl true
  def render(assigns) do
    ~H"""
    <main class="home">
      <h1><.logo /><span>Situ Studio</span></h1>
      <p class="hint">{count(length(@items))}</p>
      <div class="list">
        <a :for={item <- @items} :key={item.id} class="item"
            href={Situ.Studio.Web.Address.of(item.id)}><b>{item.title}</b><span
            class="dim">{kind(item.kind)}</span><span class="dim">{at(item)}</span></a>
      </div>
      <p :if={@items == []} class="hint">Nothing has been recorded here yet; what is recorded shows up by itself.</p>
    </main>
    """
  end

  # When it was last written to, in the time of this machine.
  defp at(%{path: path}) when is_binary(path) do
    case File.stat(path, time: :local) do
      {:ok, %{mtime: mtime}} ->
        mtime |> NaiveDateTime.from_erl!() |> NaiveDateTime.to_string() |> String.slice(0, 16)

      _ ->
        ""
    end
  end

  defp at(_), do: ""

  defp kind(:store), do: "recording"
  defp kind(:pipeline), do: "running pipeline"
  defp kind(:source), do: "in memory"

  defp count(1), do: "1 thing to look at"
  defp count(n), do: "#{n} things to look at"
end
