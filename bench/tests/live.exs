defmodule Situ.Bench.Live.Table do
  @moduledoc false
  # A page with a table of n rows. The event "set" changes one row.
  use Situ.Live.View

  @impl true
  def mount(%{"n" => n}, _session, socket) do
    n = String.to_integer(n)
    {:ok, assign(socket, rows: for(i <- 1..n, do: {i, "row #{i}", 0}), n: n)}
  end

  @impl true
  def handle_event("set", %{"i" => i, "v" => v}, socket),
    do: {:noreply, update(socket, :rows, &List.replace_at(&1, i - 1, {i, "row #{i}", v}))}

  @impl true
  def render(assigns) do
    ~H"""
    <h1>{@n} rows</h1>
    <table>
      <tr :for={{i, name, v} <- @rows} :key={i} id={"r#{i}"} class={v > 5 && "hot"}><td>{name}</td><td>{v}</td></tr>
    </table>
    """
  end
end

defmodule Situ.Bench.Live do
  @moduledoc false
  # The LiveView server: an event that changes one row of a table, and a small page over HTTP. The
  # client is a raw socket in the same VM, so the CPU time includes both ends.
  import Situ.Bench, only: [measure: 3, measure: 4]
  alias Situ.Bench.Live.Table
  alias Situ.Live.{Diff, ViewLifecycle, Socket}

  def tests do
    [
      {"live-diff", &diff(round(2_000 * &1))},
      {"live-http", &http(round(5_000 * &1))}
    ]
  end

  defp diff(n) do
    Enum.flat_map([40, 1_000], fn rows ->
      {:ok, socket} = Table.mount(%{"n" => "#{rows}"}, %{}, %Socket{id: "bench", view: Table})
      {_, memory} = Diff.diff_tree(ViewLifecycle.render_view(socket, :all))
      n = div(n * 40, rows)

      measure("live_diff_#{rows}_rows", n, "diffs/s", fn ->
        Enum.reduce(1..n, {Socket.__clear_message__(socket), memory}, fn i, {socket, memory} ->
          {:noreply, socket} = Table.handle_event("set", %{"i" => 3, "v" => i}, socket)
          {diff, memory} = Diff.diff_tree(ViewLifecycle.render_view(socket, :changed), memory)
          %{"0" => %{"1" => %{"k" => %{"2" => %{"3" => _}, "kc" => ^rows}}}} = diff
          {Socket.__clear_message__(socket), memory}
        end)
      end)
    end)
  end

  defp serve(routes) do
    {:ok, server} = Situ.Live.start_link(port: 0, routes: routes)
    {server, Situ.Live.port(server)}
  end

  defp http(n) do
    {server, port} = serve([{:get, "/", fn _ -> Situ.Live.Response.text("hello world") end}])
    {:ok, socket} = :gen_tcp.connect(~c"localhost", port, [:binary, active: false, nodelay: true])
    request = "GET / HTTP/1.1\r\nhost: localhost\r\n\r\n"
    :ok = :gen_tcp.send(socket, request)
    {:ok, first} = :gen_tcp.recv(socket, 0, 5_000)
    size = byte_size(first)

    result =
      measure("live_http", n, fn ->
        for _ <- 1..n do
          :ok = :gen_tcp.send(socket, request)
          {:ok, answer} = :gen_tcp.recv(socket, size, 5_000)
          true = String.ends_with?(answer, "hello world")
        end

        :ok
      end)

    Supervisor.stop(server)
    result
  end
end
