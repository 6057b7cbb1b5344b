defmodule Situ.Live.Test do
  @moduledoc """
  Tests views without a browser or a server: mount, look, click, type, assert.

      page = Situ.Live.Test.mount(Counter, params: %{"from" => "1"})
      assert Situ.Live.Test.text(page, "#inc") == "0"
      Situ.Live.Test.click(page, "#inc")
      assert Situ.Live.Test.text(page, "#inc") == "1"

  The view runs in a separate process, as with a browser, and its messages are merged as a browser merges them. When a
  function returns, the view has handled all earlier messages, so tests need not wait or sleep. Supported selectors:
  `tag`, `#id`, `.class`, `[name=value]`, and descendants.
  """
  alias Situ.Live.{Endpoint, Query, Route}
  alias Situ.Live.Test.{Browser, Dom}

  defstruct [:browser, :view]

  @type t :: %__MODULE__{browser: pid(), view: pid()}

  @doc """
  Mounts a view as a connected browser does. Options: `path:` (default `"/"`; its query becomes params), `params:`,
  `session:`, `action:`, `routes:` (more live routes, for patches), `connect_params:`.

  Raises with the reason if the view does not mount. Returns `{:error, {:redirect, to}}` if the view redirects the
  browser.
  """
  @spec mount(module(), keyword()) :: t() | {:error, {atom(), String.t()}}
  def mount(view, opts \\ []) do
    path = Keyword.get(opts, :path, "/")
    own_route = {:live, URI.parse(path).path, view, action: opts[:action]}
    routes = Route.compile([own_route | Keyword.get(opts, :routes, [])])

    config = %Endpoint{
      ref: make_ref(),
      routes: routes,
      secret: "",
      ip: {127, 0, 0, 1},
      port: 0,
      scheme: "http",
      flow: %{interval_ms: 0}
    }

    uri = "http://localhost" <> path
    {:ok, route, params} = Situ.Live.ViewLifecycle.fetch_route(config, uri)

    join = %{
      config: config,
      id: "phx-test",
      topic: "lv:phx-test",
      join_ref: "join",
      ref: "join",
      uri: uri,
      session: Keyword.get(opts, :session, %{}),
      route: route,
      params: Map.merge(params, Keyword.get(opts, :params, %{})),
      parameters: Keyword.get(opts, :connect_params, %{"situ_flow" => "1"})
    }

    {:ok, browser} = Browser.start_link(join)
    mount_result(call_browser(browser, :joined), browser)
  end

  defp mount_result(:ok, browser) do
    {view, _} = call_browser(browser, :view)
    %__MODULE__{browser: browser, view: view}
  end

  defp mount_result({:error, %{"redirect" => %{"to" => to}}}, _), do: {:error, {:redirect, to}}

  defp mount_result({:error, %{"live_redirect" => %{"to" => to}}}, _),
    do: {:error, {:live_redirect, to}}

  defp mount_result({:error, reason}, _), do: raise("the view did not mount: #{inspect(reason)}")

  @doc "Returns the HTML that the browser shows now."
  @spec render(t()) :: String.t()
  def render(%__MODULE__{} = page) do
    settle_view(page)
    call_browser(page.browser, :html)
  end

  # The first round covers messages in the mailbox, the next ones the acknowledgements of their diffs.
  defp settle_view(page) do
    for _ <- 1..3, Process.alive?(page.view) do
      :sys.get_state(page.view)
      call_browser(page.browser, :title)
    end

    :ok
  catch
    :exit, _ -> :ok
  end

  @doc "Returns the joined and trimmed text of the elements that match a selector; raises if there are none."
  @spec text(t(), String.t()) :: String.t()
  def text(page, selector),
    do: page |> fetch_elements!(selector) |> Dom.text_content() |> String.trim()

  @doc "Returns whether any element matches a selector."
  @spec has_element?(t(), String.t()) :: boolean()
  def has_element?(page, selector), do: find_elements(page, selector) != []

  @doc "Counts the elements that match a selector."
  @spec count_elements(t(), String.t()) :: non_neg_integer()
  def count_elements(page, selector), do: page |> find_elements(selector) |> length()

  @doc "Returns an attribute of the first element that matches a selector, or `nil`."
  @spec get_attribute(t(), String.t(), String.t()) :: String.t() | nil
  def get_attribute(page, selector, name) do
    [{_, attributes, _} | _] = fetch_elements!(page, selector)
    attributes[name]
  end

  defp find_elements(page, selector),
    do: page |> render() |> Dom.parse() |> Dom.find_all(selector)

  defp fetch_elements!(page, selector) do
    case find_elements(page, selector) do
      [] -> raise ArgumentError, "no element matches #{inspect(selector)} in\n" <> render(page)
      elements -> elements
    end
  end

  @doc """
  Clicks the first element that matches a selector: sends its `phx-click` (or follows its link), with its
  `phx-value-*`. Returns `:ok`, `{:ok, reply}` after a `{:reply, ...}`, or `{:error, reason}` if the view died.
  """
  @spec click(t(), String.t(), map()) :: :ok | {:ok, map()} | {:error, term()}
  def click(page, selector, value \\ %{}) do
    [{_, attributes, _} | _] = fetch_elements!(page, selector)

    case attributes do
      %{"disabled" => _} ->
        raise ArgumentError, "#{selector} is disabled"

      %{"phx-click" => "[" <> _ = json} ->
        run_commands(page, json, event_values(attributes, value))

      %{"phx-click" => event} ->
        send_event(page, event, event_values(attributes, value), "click")

      %{"data-phx-link" => "patch", "href" => to} ->
        patch(page, to)

      %{"data-phx-link" => "redirect", "href" => to} ->
        {:ok, %{"live_redirect" => to}}

      _ ->
        raise ArgumentError, "#{selector} has no phx-click"
    end
  end

  defp run_commands(page, json, value) do
    {:ok, commands} = Situ.JSON.decode(json)

    for ["push", %{"event" => event} = args] <- commands, reduce: :ok do
      _ -> send_event(page, event, Map.merge(value, args["value"] || %{}), "click")
    end
  end

  defp event_values(attributes, value) do
    values = for {"phx-value-" <> name, text} <- attributes, into: %{}, do: {name, text}

    values =
      if attributes["value"], do: Map.put(values, "value", attributes["value"]), else: values

    Map.merge(values, value)
  end

  @doc "Sends a form's `phx-change` with fields (nested maps of strings); `target:` is the path of the changed field."
  @spec change(t(), String.t(), map(), keyword()) :: :ok | {:ok, map()} | {:error, term()}
  def change(page, selector, fields, opts \\ []) do
    meta = if opts[:target], do: %{"_target" => Query.field_name(opts[:target])}, else: %{}
    send_form(page, selector, "phx-change", fields, meta)
  end

  @doc "Submits a form: sends its `phx-submit`."
  @spec submit(t(), String.t(), map()) :: :ok | {:ok, map()} | {:error, term()}
  def submit(page, selector, fields), do: send_form(page, selector, "phx-submit", fields, %{})

  defp send_form(page, selector, kind, fields, meta) do
    event =
      get_attribute(page, selector, kind) || raise(ArgumentError, "#{selector} has no #{kind}")

    push_message(page, "event", %{
      "type" => "form",
      "event" => event,
      "value" => Query.encode(fields),
      "meta" => meta
    })
  end

  @doc "Sends an event as a hook or a key press does."
  @spec send_event(t(), String.t(), map(), String.t()) :: :ok | {:ok, map()} | {:error, term()}
  def send_event(page, name, value \\ %{}, type \\ "hook"),
    do:
      push_message(page, "event", %{
        "type" => type,
        "event" => name,
        "value" => round_trip_json(value)
      })

  # A browser sends only JSON.
  defp round_trip_json(value) do
    {:ok, value} = value |> Situ.JSON.encode() |> Situ.JSON.decode()
    value
  end

  @doc "Navigates within the view, as a patch link or the browser history does."
  @spec patch(t(), String.t()) :: :ok | {:ok, map()} | {:error, term()}
  def patch(page, to), do: push_message(page, "live_patch", %{"url" => "http://localhost" <> to})

  @doc "Sends a raw message, to test input that a browser would not send."
  @spec push_message(t(), String.t(), term()) :: :ok | {:ok, map()} | {:error, term()}
  def push_message(page, event, payload) do
    case call_browser(page.browser, {:push, event, payload}) do
      {:ok, reply} when reply == %{} -> settle_view(page)
      result -> settle_and_return(page, result)
    end
  end

  defp settle_and_return(page, result) do
    settle_view(page)
    result
  end

  @doc "Sends the view's process a message (`handle_info/2`)."
  @spec send_info(t(), term()) :: :ok
  def send_info(page, message) do
    send(page.view, message)
    settle_view(page)
  end

  @doc "Returns the payloads of the `push_event`s of this name since the last call, oldest first."
  @spec take_pushed_events(t(), String.t()) :: [map()]
  def take_pushed_events(page, name) do
    settle_view(page)
    call_browser(page.browser, {:events, name})
  end

  @doc "Returns the navigations that the view sent: `{:live_patch | :live_redirect | :redirect, path}`, oldest first."
  @spec list_visits(t()) :: [{atom(), String.t()}]
  def list_visits(page) do
    settle_view(page)
    call_browser(page.browser, :visits)
  end

  @doc "Returns the page's title."
  @spec page_title(t()) :: String.t() | nil
  def page_title(page) do
    settle_view(page)
    call_browser(page.browser, :title)
  end

  @doc "Returns whether the view's process is alive."
  @spec alive?(t()) :: boolean()
  def alive?(page), do: Process.alive?(page.view)

  @doc "Returns the HTML of a component with the given assigns."
  @spec render_component((map() -> term()), Enumerable.t()) :: String.t()
  def render_component(fun, assigns \\ %{}) do
    %{__changed__: nil, inner_block: []}
    |> Map.merge(Map.new(assigns))
    |> fun.()
    |> Situ.Live.Html.escape()
    |> Situ.Live.Html.to_html()
  end

  # Pages may be slow on a busy machine, and these tests do not measure speed.
  @timeout_ms 60_000

  defp call_browser(browser, request), do: GenServer.call(browser, request, @timeout_ms)
end
