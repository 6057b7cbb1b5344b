defmodule Situ.Studio do
  @schema [
    path: [
      type: {:optional, :string},
      default: nil,
      doc: "A recording, or a folder with recordings at any depth."
    ],
    pipelines: [
      type: :list,
      default: [],
      doc:
        "Running pipelines to look into: pids, names, or functions that find them; `{title, pipeline}` gives a title."
    ],
    recordings: [
      type: {:optional, {:fun, 1}},
      default: nil,
      doc:
        "Finds a recording of another node, `NODE/NAME`: answers its address and options of its reader " <>
          "(`Situ.Cluster.Recordings.address/1`)."
    ],
    sources: [
      type: :map,
      default: %{},
      doc: "Other sources by name: `%{\"name\" => {module, handle}}`, see `Situ.Studio.Source`."
    ],
    port: [type: {:range, 0, 65_535}, default: 4040, doc: "The port; 0 takes a free one."],
    ip: [
      type: :any,
      default: {127, 0, 0, 1},
      doc: "The address to listen on. Anything but loopback needs the token."
    ],
    token: [
      type: {:or, [:string, {:in, [:auto, :none]}]},
      default: :auto,
      doc:
        "The text that a browser must bring; a random one where one is needed and none is given."
    ],
    viewer_token: [
      type: {:or, [:string, {:in, [:auto, :none]}]},
      default: :auto,
      doc:
        "The text of links for those who may only look; a random one where there is a token and none is given."
    ],
    tls: [
      type: {:or, [:keyword, {:in, [:own]}]},
      default: [],
      doc:
        "`certfile:` and `keyfile:` of a certificate, or `:own` for one that is made for this " <>
          "machine's names and kept " <>
          "in the user's configuration folder (`Situ.Certificate`)."
    ],
    hosts: [type: :any, default: nil, doc: "Host names the server answers for; see `Situ.Live`."],
    public: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The address of the studio behind a proxy, such as `https://lab.example.org/studio`; see the guide " <>
          "\"The studio\"."
    ],
    read_only: [type: :boolean, default: false, doc: "Nothing on disk can be changed."],
    layouts: [type: {:optional, :string}, default: nil, doc: "The folder of saved layouts."],
    visualizers: [
      type: :list,
      default: [],
      doc: "Modules of further ways to draw streams, see `Situ.Studio.Visualizer`."
    ],
    adapters: [
      type: :list,
      default: [],
      doc: "Modules that make of messages what visualizers take, see `Situ.Studio.Adapter`."
    ],
    plugins: [
      type: :list,
      default: [],
      doc: "Folders of plug-ins, see `Situ.Studio.Plugins`; or plug-ins that are loaded already."
    ],
    tiles: [
      type: {:optional, :string},
      default: nil,
      doc:
        "Where maps take their pictures from: `https://.../{z}/{x}/{y}.png`, or a folder of such files. None are " <>
          "fetched without it."
    ],
    tiles_credit: [
      type: {:optional, :string},
      default: nil,
      doc: "Who made these pictures, to be named on the map."
    ],
    id: [type: :string, default: "studio", doc: "Tells several studios of one VM apart."]
  ]
  @moduledoc """
  The studio: recordings and running pipelines in a browser. On the command line it is `bin/situ studio PATH`; in an
  application it is a child:

      children = [{Situ.Studio, path: "recordings", port: 4040}]

  and shows pipelines of the same VM while they run:

      {:ok, pipeline} = Lobby.start_link(file: "talk1.mp4")
      {:ok, studio} = Situ.Studio.start_link(pipelines: [pipeline])

  It listens on `127.0.0.1`. Told to listen elsewhere, it asks every browser for a token: `url/1` gives the address that
  carries it.

  ## Options

  #{Situ.Options.docs(@schema)}

  ## How it works

  The page is a LiveView (`Situ.Live`): streams, layout and properties come from a process on the server. Times, cursor
  and drawing live in the page. Data comes on one WebSocket, as binary answers to the page's own requests
  (`Situ.Studio.DataSession`, `Situ.Studio.Frame`), at most one under way: a slow browser asks less often and slows
  nothing down. Each way to draw a stream is a module here and one in the page (`Situ.Studio.Visualizer`).
  """
  use Supervisor

  alias Situ.Studio.{Alerts, Batch, Catalog, PipelineView, Plugins, Tiles, Web}

  @doc "A child of a supervision tree."
  @spec child_spec(keyword()) :: Supervisor.child_spec()
  def child_spec(opts),
    do: %{
      id: {__MODULE__, opts[:id] || "studio"},
      start: {__MODULE__, :start_link, [opts]},
      type: :supervisor
    }

  @doc "Starts a studio. A port in use and the like are `{:error, error}`; a wrong option raises."
  @spec start_link(keyword()) :: {:ok, pid()} | {:error, Situ.Error.t()}
  def start_link(opts) do
    opts = Situ.Options.validate!(opts, @schema)

    with {:ok, tls} <- tls(opts[:tls], opts[:ip]),
         {:ok, tiles} <- Tiles.new(opts[:tiles], opts[:tiles_credit]),
         do: start(Keyword.merge(opts, tls: tls, tiles: tiles))
  end

  defp tls(:own, ip), do: Situ.Certificate.own(ip)
  defp tls(given, _ip), do: {:ok, given}

  defp start(opts) do
    case Supervisor.start_link(__MODULE__, opts) do
      {:error, {:shutdown, {:failed_to_start_child, _, %Situ.Error{} = error}}} ->
        {:error, error}

      {:error, {:shutdown, {:failed_to_start_child, Catalog, {:already_started, _}}}} ->
        {:error,
         Situ.Error.new(:already_started, "a studio called #{inspect(opts[:id])} runs already",
           fix: "give the second one another id:"
         )}

      other ->
        other
    end
  end

  @impl true
  def init(opts) do
    {loaded, folders} = Enum.split_with(opts[:plugins], &is_struct(&1, Plugins.Plugin))
    plugins = loaded ++ Plugins.load(folders)
    Plugins.register(plugins)
    visualizers = Plugins.visualizers(plugins, opts[:visualizers], opts[:adapters])
    opts = Keyword.merge(opts, visualizers: visualizers, plugins: plugins)

    children = [
      {DynamicSupervisor, name: Catalog.watches(opts[:id]), strategy: :one_for_one},
      {Catalog,
       Keyword.take(
         opts,
         [:id, :path, :pipelines, :recordings, :sources, :read_only, :layouts, :visualizers] ++
           [:plugins, :tiles]
       )},
      {Batch, Keyword.take(opts, [:id])},
      {Alerts, Keyword.take(opts, [:id])},
      {PipelineView.Past, Keyword.take(opts, [:id, :pipelines])},
      {Situ.Live, live(opts)}
    ]

    Supervisor.init(children, strategy: :rest_for_one)
  end

  defp live(opts) do
    [
      port: opts[:port],
      ip: opts[:ip],
      token: opts[:token],
      viewer_token: opts[:viewer_token],
      routes:
        Web.Routes.all(opts[:id], base(opts)) ++
          Plugins.routes(opts[:plugins]) ++
          Tiles.routes(opts[:tiles]) ++ [{:get, "/*path", {Web.NotFoundPage, base(opts)}}],
      images: Tiles.origins(opts[:tiles]),
      layout: &Web.Chrome.layout(Map.put(&1, :base, base(opts))),
      max_frame: 262_144
    ] ++
      if(opts[:hosts], do: [hosts: opts[:hosts]], else: []) ++
      if(opts[:public], do: [public: opts[:public]], else: []) ++
      if(opts[:tls] != [], do: [tls: opts[:tls]], else: [])
  end

  # The base of every link in a page.
  defp base(opts) do
    case Situ.Live.Public.parse(opts[:public]) do
      {:ok, %{base: base}} -> base <> "/"
      _ -> "/"
    end
  end

  @doc "The port a studio listens on."
  @spec port(Supervisor.supervisor()) :: :inet.port_number()
  def port(studio), do: studio |> live_server() |> Situ.Live.port()

  @doc "The address to open, with the token when one is needed; `item` opens one recording."
  @spec url(Supervisor.supervisor(), String.t() | nil) :: String.t()
  def url(studio, item \\ nil) do
    path = if item, do: "/" <> Web.Address.of(item), else: "/"
    studio |> live_server() |> Situ.Live.url(path)
  end

  @doc """
  The address for those who may only look: the server refuses to change, write or run anything for them. `nil` where the
  studio needs no token (on the machine itself); `viewer_token:` gives it one.
  """
  @spec viewer_url(Supervisor.supervisor(), String.t() | nil) :: String.t() | nil
  def viewer_url(studio, item \\ nil) do
    path = if item, do: "/" <> Web.Address.of(item), else: "/"
    studio |> live_server() |> Situ.Live.viewer_url(path)
  end

  @doc "The one thing there is to look at, when there is just one: then a browser need not choose."
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

  defp live_server(studio) do
    studio
    |> Supervisor.which_children()
    |> Enum.find_value(fn {id, pid, _, _} -> match?({Situ.Live, _}, id) && pid end)
  end
end
