defmodule Situ.Studio.Web.ClusterView do
  @moduledoc false
  # Serves the page of a cluster: its nodes, the deployed parts with their streams, the links of all nodes, and
  # readers that are catching up. The page is available if the studio's own node is a member. It only displays the
  # cluster.
  use Situ.Live.View
  import Situ.Studio.Web.Icons
  alias Situ.Cluster.Overview
  alias Situ.Studio.{ClusterRates, StreamTotals}
  alias Situ.Studio.Web.Paths

  @refresh_ms 1_000

  @impl true
  def mount(_params, session, socket) do
    socket =
      assign(socket,
        studio: session["studio"],
        page_title: "Cluster",
        member: cluster_member?(),
        opens: opens_remote?(session["studio"]),
        before: nil,
        now: nil
      )

    if connected?(socket), do: request_overview()

    {:ok,
     if(connected?(socket) or not cluster_member?(),
       do: socket,
       else: assign(socket, now: Overview.now())
     )}
  end

  @doc "Returns whether the studio's node is a member of a cluster."
  @spec cluster_member?() :: boolean()
  def cluster_member?, do: Process.whereis(Situ.Cluster.Agent) != nil

  # Returns whether the studio was configured to open recordings and pipelines of other nodes.
  defp opens_remote?(studio) do
    match?([{_, %{nodes: true}}], Registry.lookup(Situ.Studio.Registry, studio))
  end

  # The overview is fetched in a task, so an unresponsive node does not block the page.
  defp request_overview do
    page = self()

    Task.Supervisor.start_child(Situ.Studio.Tasks, fn ->
      send(page, {:overview, if(cluster_member?(), do: Overview.now())})
    end)
  end

  @impl true
  def handle_info({:overview, overview}, socket) do
    Process.send_after(self(), :look, @refresh_ms)
    before = if overview, do: socket.assigns.now
    {:noreply, assign(socket, member: overview != nil, before: before, now: overview)}
  end

  def handle_info(:look, socket) do
    request_overview()
    {:noreply, socket}
  end

  def handle_info(_other, socket), do: {:noreply, socket}

  # This page has no buttons, but a page of another studio version may send events that are unknown here.
  @impl true
  def handle_event(_event, _params, socket), do: {:noreply, socket}

  @impl true
  def render(%{now: nil} = assigns) do
    ~H"""
    <main class="home cluster" id="cluster">
      <h1><a class="brand" href="." title="All recordings"><.logo /></a><span>Cluster</span></h1>
      <p :if={@member} class="hint" role="status">Querying the nodes …</p>
      <p :if={not @member} class="hint" role="status">The studio's node is not a member of a cluster.
        <code>situ cluster join NAME --log LOG --studio 4040</code> starts a member with a studio that shows it.</p>
    </main>
    """
  end

  def render(assigns) do
    assigns =
      assign(assigns,
        streams: ClusterRates.stream_rates(assigns.before, assigns.now),
        links: ClusterRates.link_rates(assigns.before, assigns.now)
      )

    ~H"""
    <main class="home cluster" id="cluster">
      <h1><a class="brand" href="." title="All recordings"><.logo /></a><span>Cluster</span></h1>
      <p class="hint" role="status">{summary_text(@now)}</p>
      <table id="nodes">
        <caption>Nodes</caption>
        <thead><tr><th scope="col">Node</th><th scope="col" class="text">Labels, devices</th><th scope="col">Parts</th>
          <th scope="col">CPU</th><th scope="col">Machine</th><th scope="col">Memory</th>
          <th scope="col">Round trip</th></tr></thead>
        <tbody>
          <tr :for={n <- @now.nodes} :key={n.node}>
            <th scope="row">{n.node}{if n.node == @now.own_node, do: " (here)"}</th>
            <td class="text">{Enum.join(n.labels ++ n.devices, ", ")}</td>
            <td>{count_parts(@now, n.node)}</td>
            <td>{format_cores(n)}</td>
            <td>{format_percent(n.machine)}</td>
            <td>{n.memory && StreamTotals.format_bytes(n.memory)}</td>
            <td>{format_ms(n.trip)}</td>
          </tr>
        </tbody>
      </table>
      <table id="parts">
        <caption>Parts and their streams</caption>
        <thead><tr><th scope="col">Part</th>
          <th scope="col" class="text">Node</th><th scope="col" class="text">State</th>
          <th scope="col">Checkpoints</th><th scope="col" class="text">Stream</th><th scope="col">Messages</th>
          <th scope="col">Per second</th>
          <th scope="col" class="text">Readers</th></tr></thead>
        <tbody>
          <tr :for={row <- part_rows(@now)} :key={row.key} class={to_string(row.part.phase)}>
            <th :if={row.first? and row.part.pipeline != nil} scope="row"><a
              href={Paths.pipeline_path(part_title(row.part))}>{part_title(row.part)}</a></th>
            <th :if={not row.first? or row.part.pipeline == nil} scope="row">{row.first? && part_title(row.part)}</th>
            <td class="text">{row.first? && (row.part.node || "none")}</td>
            <td class="text" title={row.part.error}>{row.first? && row.part.phase}</td>
            <td>{row.first? && row.part.checkpoints}</td>
            <td class="text">{row.stream && row.stream.name}</td>
            <td>{row.stream && row.stream.messages}</td>
            <td>{format_rate(@streams[row.key])}</td>
            <td class="text"><span :for={r <- reader_labels(row, @streams)} class={r.class}>{r.text}</span></td>
          </tr>
        </tbody>
      </table>
      <p :if={@now.parts == []} class="hint">Nothing is deployed. Run <code>situ cluster deploy MODULE</code>.</p>
      <table :if={@now.links != []} id="links">
        <caption>Links</caption>
        <thead><tr><th scope="col">To</th><th scope="col" class="text">Node</th><th scope="col" class="text">State</th>
          <th scope="col">Bytes per second</th><th scope="col">Round trip</th>
          <th scope="col">Clock offset</th></tr></thead>
        <tbody>
          <tr :for={l <- @now.links} :key={{l.node, l.address}} class={if l.connected?, do: "running", else: "failed"}>
            <th scope="row">{l.address}</th>
            <td class="text">{l.node}</td>
            <td class="text">{if l.connected?, do: "connected", else: "lost"}</td>
            <td>{format_bytes(@links[{l.node, l.address}])}</td>
            <td>{format_ms(l.round_trip)}</td>
            <td>{format_clock_offset(l)}</td>
          </tr>
        </tbody>
      </table>
      <table :if={@now.recordings != []} id="recordings">
        <caption>Recordings</caption>
        <thead><tr><th scope="col">Recording</th>
          <th scope="col" class="text">Node</th><th scope="col" class="text">State</th></tr></thead>
        <tbody>
          <tr :for={r <- @now.recordings} :key={r.id} id={"recording-" <> r.id}>
            <th :if={@opens} scope="row"><a href={Paths.source_path(r.id)}>{r.name}</a></th>
            <th :if={not @opens} scope="row">{r.name}</th>
            <td class="text">{r.node}</td>
            <td class="text">{if r.live?, do: "being recorded", else: "finished"}</td>
          </tr>
        </tbody>
      </table>
      <p class="hint"><a href=".">All recordings and pipelines</a></p>
      <div id="toast" role="status" phx-update="ignore"></div>
    </main>
    """
  end

  defp summary_text(now) do
    lost = Enum.count(now.parts, &(&1.phase in [:standby, :failed]))

    parts =
      "#{format_count(length(now.nodes), "node")}, #{format_count(length(now.parts), "part")}"

    if lost == 0, do: parts, else: parts <> ", #{lost} not running"
  end

  defp format_count(1, word), do: "1 " <> word
  defp format_count(n, word), do: "#{n} #{word}s"

  defp count_parts(now, node), do: Enum.count(now.parts, &(&1.node == node))
  defp part_title(part), do: "#{part.deployment}/#{part.part}"

  # A part has one row for each of its streams, or a single row if it has no streams.
  defp part_rows(now) do
    for part <- now.parts,
        {stream, i} <- Enum.with_index(if part.streams == [], do: [nil], else: part.streams) do
      key = {part.deployment, part.part, stream && stream.name}
      %{part: part, stream: stream, first?: i == 0, key: key}
    end
  end

  defp reader_labels(%{stream: nil}, _rates), do: []

  defp reader_labels(%{stream: stream, key: key}, rates) do
    for reader <- stream.readers do
      if ClusterRates.catching_up?(reader.behind, rates[key] || 0.0),
        do: %{text: "#{reader.part}: catching up, #{reader.behind} behind", class: "behind"},
        else: %{text: reader.part, class: nil}
    end
  end

  defp format_cores(%{busy: nil}), do: nil
  defp format_cores(n), do: "#{format_fixed(n.busy, 2)} of #{n.cores}"
  defp format_percent(nil), do: nil
  defp format_percent(part), do: "#{round(part * 100)} %"
  defp format_rate(nil), do: nil
  defp format_rate(n), do: format_fixed(n, 1)
  defp format_bytes(nil), do: nil
  defp format_bytes(n), do: StreamTotals.format_bytes(round(n))
  defp format_ms(nil), do: nil
  defp format_ms(ns), do: format_fixed(ns / 1.0e6, 2) <> " ms"
  defp format_clock_offset(%{offset: nil}), do: nil

  defp format_clock_offset(l),
    do:
      "#{format_fixed(l.offset / 1.0e6, 2)} ± #{format_fixed((l.uncertainty || 0) / 1.0e6, 2)} ms"

  defp format_fixed(n, places), do: :erlang.float_to_binary(n / 1, decimals: places)
end
