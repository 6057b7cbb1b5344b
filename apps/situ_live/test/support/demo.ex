defmodule Situ.Live.Demo.Parts do
  @moduledoc false
  use Situ.Live.Component

  attr(:tone, :string, default: "plain")
  attr(:title, :string, required: true)
  attr(:rest, :global)
  slot(:inner_block)
  slot(:foot)

  def card(assigns) do
    ~H"""
    <section class={["card", @tone]} {@rest}>
      <h2>{@title}</h2>
      {render_slot(@inner_block)}
      <footer :if={@foot != []}>{render_slot(@foot)}</footer>
    </section>
    """
  end

  def table(assigns) do
    ~H"""
    <table id={@id}>
      <thead><tr><th :for={c <- @col}>{c.label}</th></tr></thead>
      <tbody>
        <tr :for={r <- @rows} :key={r.id} id={"#{@id}-#{r.id}"}>
          <td :for={c <- @col}>{render_slot(c, r)}</td>
        </tr>
      </tbody>
    </table>
    """
  end
end

defmodule Situ.Live.Demo.Main do
  @moduledoc false
  # Everything a page can do, in one view: used by the browser test, the differ test and the tests without a browser.
  use Situ.Live.View
  alias Situ.Live.Demo.Parts
  import Parts, only: [card: 1]

  @impl true
  def mount(_params, session, socket) do
    rows = for i <- 1..5, do: %{id: i, name: "row #{i}", v: i}
    if connected?(socket), do: send(self(), :hello)

    socket =
      socket
      |> assign(count: 0, rows: rows, q: "", open: false, tick: 0, note: "", tab: "a")
      |> assign(nasty: "<b>&\"'</b>", page_title: "demo", user: session["user"], dis: false)
      |> stream(:lines, [%{id: 1, text: "one"}, %{id: 2, text: "two"}])

    {:ok, socket}
  end

  @impl true
  def handle_params(params, _uri, socket),
    do: {:noreply, assign(socket, :tab, params["tab"] || "a")}

  @impl true
  def handle_event("inc", _, s), do: {:noreply, update(s, :count, &(&1 + 1))}
  def handle_event("toggle", _, s), do: {:noreply, update(s, :open, &(not &1))}
  def handle_event("dis", _, s), do: {:noreply, update(s, :dis, &(not &1))}
  def handle_event("reverse", _, s), do: {:noreply, update(s, :rows, &Enum.reverse/1)}

  def handle_event("add", _, s) do
    n = length(s.assigns.rows) + 1
    {:noreply, update(s, :rows, &(&1 ++ [%{id: n, name: "row #{n}", v: n}]))}
  end

  def handle_event("bump", %{"id" => id}, s) do
    id = String.to_integer(id)
    bump = fn r -> if r.id == id, do: %{r | v: r.v + 100}, else: r end
    {:noreply, update(s, :rows, &Enum.map(&1, bump))}
  end

  def handle_event("del", %{"id" => id}, s) do
    {:noreply, update(s, :rows, &Enum.reject(&1, fn r -> r.id == String.to_integer(id) end))}
  end

  def handle_event("form", %{"f" => %{"q" => q}}, s),
    do: {:noreply, s |> assign(:q, q) |> assign(:note, "len #{String.length(q)}")}

  def handle_event("save", %{"f" => %{"q" => q}}, s),
    do: {:noreply, assign(s, :note, "saved #{q}")}

  def handle_event("draw", p, s), do: {:noreply, push_event(s, "points", %{pts: p["n"] || 3})}
  def handle_event("ask", p, s), do: {:reply, %{echo: p}, s}
  def handle_event("crash", _, _), do: raise("boom")
  def handle_event("patch", _, s), do: {:noreply, push_patch(s, to: "/?tab=c")}
  def handle_event("go", _, s), do: {:noreply, push_navigate(s, to: "/other")}

  def handle_event("line", _, s),
    do: {:noreply, stream_insert(s, :lines, %{id: 3, text: "three"}, at: 0)}

  def handle_event("unline", _, s), do: {:noreply, stream_delete(s, :lines, %{id: 1})}

  def handle_event("relines", _, s),
    do: {:noreply, stream(s, :lines, [%{id: 9, text: "nine"}], reset: true)}

  def handle_event("ticks", %{"n" => n}, s) do
    send(self(), {:tick, n})
    {:noreply, s}
  end

  @impl true
  def handle_info(:hello, s), do: {:noreply, push_event(s, "points", %{pts: 1})}
  def handle_info({:tick, 0}, s), do: {:noreply, push_event(s, "ticked", %{})}

  def handle_info({:tick, n}, s) do
    Process.send_after(self(), {:tick, n - 1}, 5)
    {:noreply, s |> update(:tick, &(&1 + 1)) |> push_event("tick", %{n: n})}
  end

  def handle_info({:set, key, value}, s), do: {:noreply, assign(s, key, value)}

  @impl true
  def render(assigns) do
    ~H"""
    <h1>Count: <span id="count">{@count}</span></h1>
    <button id="inc" phx-click="inc" disabled={@dis}>+</button>
    <button id="dis" phx-click="dis" {%{title: "a\"b"}}>dis</button>
    <button id="toggle" phx-click="toggle">toggle</button>
    <button id="rev" phx-click="reverse">reverse</button>
    <button id="add" phx-click="add">add</button>
    <button id="crash" phx-click="crash">crash</button>
    <button id="patch" phx-click="patch">patch</button>
    <button id="go" phx-click="go">go</button>
    <button id="js" phx-click={JS.toggle(to: "#menu") |> JS.push("inc")}>js</button>
    <div id="menu" style="display: none">menu</div>
    <.link id="lp" patch="/?tab=b">tab b</.link>
    <.link id="lr" navigate="/other">other</.link>
    <p id="tab">{@tab}</p><p id="nasty">{@nasty}</p><p id="tick">{@tick}</p><p id="user">{@user}</p>
    <div :if={@open} id="open">
      open {@count}
      <em :if={rem(@count, 2) == 0}>even</em><b :if={rem(@count, 2) == 1}>odd</b>
    </div>
    <i :if={not @open} id="closed">closed</i>
    <form id="f" phx-change="form" phx-submit="save">
      <input id="q" name="f[q]" value={@q} phx-debounce="0"><span id="note">{@note}</span>
    </form>
    <form id="entries" phx-submit="enter">
      <input name="name" value="ann"><input type="checkbox" name="on" value="true">
      <textarea name="text">some</textarea>
      <select name="kind"><option value="a">a</option><option value="b" selected>b</option></select>
      <input name="count" value={@count}>
    </form>
    <ul id="list">
      <li :for={r <- @rows} :key={r.id} id={"r#{r.id}"} class={r.v > 100 && "hot"}>
        {r.name}={r.v}
        <button phx-click="bump" phx-value-id={r.id}>b</button>
        <button phx-click="del" phx-value-id={r.id}>x</button>
        <sup :if={r.v > 100}>big</sup>
      </li>
    </ul>
    <ol id="lines" phx-update="stream">
      <li :for={{id, line} <- @streams.lines} id={id}>{line.text}</li>
    </ol>
    <button id="line" phx-click="line">line</button>
    <button id="unline" phx-click="unline">unline</button>
    <button id="relines" phx-click="relines">relines</button>
    <.card title={"Count #{@count}"} tone="warm" data-x="1">
      <p :if={rem(@count, 2) == 1} id="isodd">odd {%{a: "}"}.a}</p>
      <:foot>foot {@count}</:foot>
    </.card>
    <.island>
      <div id="island">
        <Parts.table id="t" rows={Enum.take(@rows, 3)}>
          <:col :let={r} label="name">{r.name}</:col>
          <:col :let={r} :if={@open} label="v"><b>{r.v}</b></:col>
        </Parts.table>
      </div>
    </.island>
    <canvas id="cv" phx-hook="Canvas" phx-update="ignore" width="320" height="80"></canvas>
    """
  end
end

defmodule Situ.Live.Demo.Other do
  @moduledoc false
  use Situ.Live.View

  @impl true
  def mount(_params, _session, socket), do: {:ok, assign(socket, page_title: "other")}

  @impl true
  def render(assigns) do
    ~H"""
    <p id="other">other</p>
    <.link id="home" navigate="/">home</.link>
    """
  end
end

defmodule Situ.Live.Demo.Raises do
  @moduledoc false
  use Situ.Live.View

  @impl true
  def mount(_params, _session, socket) do
    if connected?(socket), do: raise("no mount for you")
    {:ok, socket}
  end

  @impl true
  def render(assigns) do
    ~H"""
    <p>here</p>
    """
  end
end
