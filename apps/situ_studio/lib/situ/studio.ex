defmodule Situ.Studio do
  @moduledoc """
  The studio shows recordings and running pipelines in a browser. Start it on the command line with
  `bin/situ studio PATH`, or as a child of an application:

      children = [{Situ.Studio, path: "recordings", port: 4040}]

  It can also show running pipelines of the same VM:

      {:ok, pipeline} = Lobby.start_link(file: "talk1.mp4")
      {:ok, studio} = Situ.Studio.start_link(pipelines: [pipeline])

  The studio listens on `127.0.0.1`. If it is configured to listen on another address, browsers need a token; `url/1`
  returns the address that includes it.

  ## How it works

  The page is a LiveView (`Situ.Live`): a process on the server provides streams, layout and properties. The page
  itself handles times, the cursor and drawing. Data arrives over one WebSocket, as binary replies to the page's
  requests (`Situ.Studio.Frame`). At most one request is in flight, so a slow browser sends fewer requests and slows
  nothing else down. Each visualizer has a module here and one in the page (`Situ.Studio.Visualizer`).
  """

  @schema [
    path: [
      type: {:optional, :string},
      default: nil,
      doc: "A recording, or a folder that contains recordings at any depth."
    ],
    pipelines: [
      type: :list,
      default: [],
      doc:
        "Running pipelines to show: pids, names, or functions that return them; `{title, pipeline}` sets a title."
    ],
    recordings: [
      type: {:optional, {:fun, 1}},
      default: nil,
      doc:
        "Finds a recording on another node by `NODE/NAME`: returns `{:ok, address, reader_opts}` or an error. " <>
          "The studio of a cluster sets it."
    ],
    sources: [
      type: :map,
      default: %{},
      doc: "Other recordings by name: `%{\"name\" => recording}`, see `Situ.Recording`."
    ],
    port: [
      type: {:or, [{:range, 0, 65_535}, {:in, [:none]}]},
      default: 4040,
      doc:
        "The port; 0 selects a free port. With `:none`, another web server serves the studio, see `Situ.Live.Adapter`."
    ],
    ip: [
      type: :any,
      default: {127, 0, 0, 1},
      doc: "The address to listen on. Any address except loopback requires the token."
    ],
    token: [
      type: {:or, [:string, {:in, [:auto, :none]}]},
      default: :auto,
      doc:
        "The token that a browser must send; a random token is generated if one is required but not given."
    ],
    viewer_token: [
      type: {:or, [:string, {:in, [:auto, :none]}]},
      default: :auto,
      doc:
        "The token of view-only links; a random token is generated if the studio has a token and this is not given."
    ],
    tls: [
      type: {:or, [:keyword, {:in, [:own]}]},
      default: [],
      doc:
        "`certfile:` and `keyfile:` of a certificate, or `:own` to generate one for this " <>
          "machine's names and store it " <>
          "in the user's configuration folder."
    ],
    hosts: [type: :any, default: nil, doc: "Host names that the server accepts; see `Situ.Live`."],
    public: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The public address of a studio served through a proxy, such as `https://lab.example.org/studio`; " <>
          "see the guide \"The studio\"."
    ],
    prefix: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The path under which a proxy serves the studio, such as `/studio`, if the proxy has the studio's host name."
    ],
    read_only: [type: :boolean, default: false, doc: "Rejects every change to files on disk."],
    layouts: [type: {:optional, :string}, default: nil, doc: "The folder for saved layouts."],
    visualizers: [
      type: :list,
      default: [],
      doc: "Additional visualizer modules, see `Situ.Studio.Visualizer`."
    ],
    adapters: [
      type: :list,
      default: [],
      doc: "Modules that convert messages for visualizers, see `Situ.Studio.Adapter`."
    ],
    plugins: [
      type: :list,
      default: [],
      doc: "Plug-in folders or plug-ins that are already loaded, see `Situ.Studio.Plugins`."
    ],
    tiles: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The source of map tiles: `https://.../{z}/{x}/{y}.png`, or a folder of such files. Without it, maps have " <>
          "no tiles."
    ],
    tiles_credit: [
      type: {:optional, :string},
      default: nil,
      doc: "The attribution of the tiles, shown on the map."
    ],
    id: [type: :string, default: "studio", doc: "Distinguishes several studios in one VM."]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  use Supervisor

  alias Situ.Live.PublicAddress
  alias Situ.Studio.{Alerts, BatchRuns, Catalog, PipelineView, Plugins, Tiles, Web}

  @doc "Returns the child specification of a studio."
  @spec child_spec(keyword()) :: Supervisor.child_spec()
  def child_spec(opts),
    do: %{
      id: {__MODULE__, opts[:id] || "studio"},
      start: {__MODULE__, :start_link, [opts]},
      type: :supervisor
    }

  @doc "Starts a studio. Runtime problems such as a port in use return `{:error, error}`; an invalid option raises."
  @spec start_link(keyword()) :: {:ok, pid()} | {:error, Situ.Error.t()}
  def start_link(opts) do
    opts = Situ.Options.validate!(opts, @schema)

    with {:ok, tls} <- resolve_tls(opts[:tls], opts[:ip]),
         {:ok, tiles} <- Tiles.new(opts[:tiles], opts[:tiles_credit]),
         do: start_supervisor(Keyword.merge(opts, tls: tls, tiles: tiles))
  end

  defp resolve_tls(:own, ip), do: Situ.Link.Certificate.ensure_local(ip)
  defp resolve_tls(options, _ip), do: {:ok, options}

  defp start_supervisor(opts) do
    case Supervisor.start_link(__MODULE__, opts) do
      {:error, {:shutdown, {:failed_to_start_child, _, %Situ.Error{} = error}}} ->
        {:error, error}

      {:error, {:shutdown, {:failed_to_start_child, Catalog, {:already_started, _}}}} ->
        {:error,
         Situ.Error.new(:already_started, "the studio #{inspect(opts[:id])} is already running",
           fix: "give the second studio a different id:"
         )}

      other ->
        other
    end
  end

  @impl true
  def init(opts) do
    {loaded, folders} = Enum.split_with(opts[:plugins], &is_struct(&1, Plugins.Plugin))
    plugins = loaded ++ Plugins.load(folders)
    Plugins.register_modules(plugins)
    visualizers = Plugins.list_visualizers(plugins, opts[:visualizers], opts[:adapters])
    opts = Keyword.merge(opts, visualizers: visualizers, plugins: plugins)

    children = [
      {DynamicSupervisor, name: Catalog.watch_supervisor(opts[:id]), strategy: :one_for_one},
      {Catalog,
       Keyword.take(
         opts,
         [:id, :path, :pipelines, :recordings, :sources, :read_only, :layouts, :visualizers] ++
           [:plugins, :tiles]
       )},
      {BatchRuns, Keyword.take(opts, [:id])},
      {Alerts, Keyword.take(opts, [:id])},
      {PipelineView.History, Keyword.take(opts, [:id, :pipelines])},
      {Situ.Live, live_options(opts)}
    ]

    Supervisor.init(children, strategy: :rest_for_one)
  end

  defp live_options(opts) do
    [
      port: opts[:port],
      ip: opts[:ip],
      token: opts[:token],
      viewer_token: opts[:viewer_token],
      routes:
        Web.Routes.build_routes(opts[:id], base_path(opts)) ++
          Plugins.script_routes(opts[:plugins]) ++
          Tiles.tile_routes(opts[:tiles]) ++
          [{:get, "/*path", {Web.NotFoundPage, base_path(opts)}}],
      images: Tiles.allowed_origins(opts[:tiles]),
      layout: &Web.PageFrame.page_layout(Map.put(&1, :base, base_path(opts))),
      max_frame: 262_144,
      prefix: opts[:prefix]
    ] ++
      if(opts[:hosts], do: [hosts: opts[:hosts]], else: []) ++
      if(opts[:public], do: [public: opts[:public]], else: []) ++
      if(opts[:tls] != [], do: [tls: opts[:tls]], else: [])
  end

  # Every link in a page starts with this path.
  defp base_path(opts) do
    {parse, address} =
      if opts[:prefix],
        do: {&PublicAddress.parse_prefix/1, opts[:prefix]},
        else: {&PublicAddress.parse/1, opts[:public]}

    case parse.(address) do
      {:ok, %{base: base}} -> base <> "/"
      _ -> "/"
    end
  end

  @doc "Returns the port that a studio listens on, or `:none`."
  @spec port(Supervisor.supervisor()) :: :inet.port_number() | :none
  def port(studio), do: studio |> live_server() |> Situ.Live.port()

  @doc "Returns the address to open, including the token if one is required; `item` opens one recording."
  @spec url(Supervisor.supervisor(), String.t() | nil) :: String.t()
  def url(studio, item \\ nil) do
    path = if item, do: "/" <> Web.Paths.source_path(item), else: "/"
    studio |> live_server() |> Situ.Live.url(path)
  end

  @doc "Returns the address of the page that shows the experiments over a dataset, by the dataset's id."
  @spec experiments_url(Supervisor.supervisor(), String.t()) :: String.t()
  def experiments_url(studio, dataset),
    do: studio |> live_server() |> Situ.Live.url("/" <> Web.Paths.experiments_path(dataset))

  @doc """
  Returns the view-only address: the server refuses to change, write or run anything for its users. Returns `nil` if
  the studio has no token (it is local only); set one with `viewer_token:`.
  """
  @spec viewer_url(Supervisor.supervisor(), String.t() | nil) :: String.t() | nil
  def viewer_url(studio, item \\ nil) do
    path = if item, do: "/" <> Web.Paths.source_path(item), else: "/"
    studio |> live_server() |> Situ.Live.viewer_url(path)
  end

  @doc "Returns the id of the only item, so that a browser need not choose; `nil` if there are none or several."
  @spec only_item(Supervisor.supervisor()) :: String.t() | nil
  def only_item(studio) do
    catalog =
      studio
      |> Supervisor.which_children()
      |> Enum.find_value(fn {id, pid, _, _} -> id == Catalog && pid end)

    case GenServer.call(catalog, :list, 30_000) do
      [item] -> item.id
      _ -> nil
    end
  end

  @doc "Returns the `Situ.Live` server of a studio, for example for an adapter (`Situ.Live.Adapter`)."
  @spec live_server(Supervisor.supervisor()) :: pid()
  def live_server(studio) do
    studio
    |> Supervisor.which_children()
    |> Enum.find_value(fn {id, pid, _, _} -> match?({Situ.Live, _}, id) && pid end)
  end
end
