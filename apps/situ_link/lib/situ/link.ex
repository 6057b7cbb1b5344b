defmodule Situ.Link do
  @moduledoc """
  Sends streams between machines, point to point: one side serves recordings, and the other opens them over TCP, TLS or
  a Unix socket.

      {:ok, server} = Situ.Link.serve("recordings/lobby", port: 11_411)           # being recorded, or finished

      link = Situ.Link.open(p, "situ://lab1/lobby", from: :resume)                # elsewhere, in build/2
      imu = Situ.Link.stream(link, "imu")
      faces = Situ.Link.stream(link, "faces", policy: Situ.Delivery.latest(), priority: 1)

  The server sends recorded messages. Messages that were recorded while nobody was connected follow later, in order and
  without duplicates. A lost link never closes a stream; the client reconnects (after 50 ms to 5 s) until the pipeline
  ends. A stream that its recorder closes is also closed on the receiving side. Guide: *Links between machines*.

  A complete example on one machine:

      iex> root = Path.join(System.tmp_dir!(), "situ-doc-link")
      iex> {:ok, _} = Situ.Pipeline.run(fn p ->
      ...>   store = Situ.Store.create(p, "lobby", root)
      ...>   p |> Situ.from_enumerable(1..3, every: 10) |> Situ.Store.write(store, "count")
      ...> end, pipeline: [replay: [interval: {0, :unbounded}, speed: :max]])
      iex> {:ok, server} = Situ.Link.serve(Path.join(root, "lobby"), port: 0)
      iex> address = "situ://127.0.0.1:\#{Situ.Link.Server.port(server)}/lobby"
      iex> Situ.to_list(fn p -> p |> Situ.Link.open(address, from: :start) |> Situ.Link.stream("count") end)
      [1, 2, 3]
      iex> Situ.Link.Server.close(server)
      iex> File.rm_rf!(root)

  ## Addresses

  | address | connection |
  |---|---|
  | `situ://host:port/name` | TCP; the default port is 11411 |
  | `situs://host:port/name` | TLS; the server's certificate must be valid for the host |
  | `situs://host/name?fingerprint=...` | TLS; accepts only the certificate with this SHA-256 fingerprint (64 digits) |
  | `situ+unix:///path/of/socket?name` | a Unix socket |

  `name` is the name of a recording. It may include a version (`lobby.0003`), and may be omitted if the server has only
  one recording. `Situ.Link.Server.address/2` returns the address of a served recording, and `bin/situ serve` prints it.

  A host without a port is looked up in this order. If none of these knows it, it is a hostname.

    1. The configured names: `config :situ_link, names: %{"lab1" => "situs://10.0.0.3:11500"}`.
    2. The processes that announce themselves over NATS (`Situ.Link.Rendezvous`), with
       `config :situ_link, nats: "nats://lab0:4222"`.
    3. The DNS service `_situ._tcp.lab1` (SRV), from the system's resolver or
       `config :situ_link, nameservers: [{{10, 0, 0, 53}, 53}]`.

  ## Recordings on other machines

  `Situ.Store` opens an address like a local path. So do `Situ.Store.importer/3`, datasets, the studio and
  `bin/situ store`:

      {:ok, store} = Situ.Store.open("situ://lab1/lobby", reader_opts: [token: "..."])
      Situ.Store.streams(store)

  An address without a version means the newest version at the time of opening. The server sends only the requested
  data: the summary of a day is a few kilobytes. If the connection is lost, the next request opens it again. Until that
  succeeds, requests return the error `:link_lost` or `:unreachable`.

  Options (`reader_opts:`):

    * `:token` - the secret that both sides share. By default it is taken from
      `config :situ_link, tokens: %{"lab1" => "..."}`, from the environment variable `SITU_TOKEN`, or from the first
      line of the file that `SITU_TOKEN_FILE` names. The error is `:no_token` if that file cannot be read.
    * `:tls` - options of `:ssl` for `situs://`
  """
  # See docs/adr/0110-links-serve-recordings.md.
  alias Situ.{Delivery, Error, Options, Pipeline}

  alias Situ.Link.{
    Access,
    Address,
    ConfirmComponent,
    Connection,
    Position,
    Rendezvous,
    ServerConfig,
    Source
  }

  alias Situ.Link.Wire.{Dialer, Handshake}
  alias Situ.Link.Server.RecordingVersions
  alias Situ.Store.{Folder, TypeName}

  @from {:or, [{:in, [:now, :start, :resume]}, :time_ns, {:tuple, [{:in, [:after]}, :string]}]}

  @link_options [
    from: [
      type: @from,
      default: :now,
      doc:
        "`:now`; `:start` (of the newest version or, for live streams, of all messages still in memory); an" <>
          " originating time; `:resume`: after the last message received, from the file `position:`; `{:after," <>
          " recording}`: for each stream, after its last message in a local recording, which is exact even if this" <>
          " side crashed."
    ],
    token: [type: :string, default: "", doc: "The secret that both sides share."],
    tls: [
      type: :keyword,
      default: [],
      doc: "Options of `:ssl` for `situs://` (`cacertfile:` ...)."
    ],
    position: [
      type: {:optional, :string},
      doc:
        "With `:resume`: the file that stores the positions. The default is a file for the address in the user's" <>
          " state folder."
    ],
    save_every: [type: :pos_integer, default: 1_000, doc: "How often to store the positions, ms."],
    wait: [
      type: :non_neg_integer,
      default: 5_000,
      doc: "How long to wait for the server while opening the link, ms."
    ],
    now: [type: {:fun, 0}, doc: false]
  ]

  @stream_options [
    type: [type: :any, doc: "The type of the data; required if the server cannot be reached now."],
    from: [type: @from, doc: "Where to begin; by default the `from:` of the link."],
    policy: [
      type: {:struct, Delivery},
      doc:
        "The messages that the sender may drop if the link is too slow: none (default), or according to `latest`," <>
          " `max_queue` or `max_latency`."
    ],
    priority: [
      type: {:range, -100, 100},
      default: 0,
      doc: "Streams with a higher priority are sent first."
    ],
    datagrams: [
      type: {:or, [:boolean, {:integer, 46, 65_507}]},
      default: false,
      doc:
        "With a lossy `policy:`: sends messages as encrypted UDP datagrams of this size (`true`: 1,200 bytes). A" <>
          " lost datagram does not delay others, and lost messages are counted (`info/1`). Has no effect over a" <>
          " Unix socket."
    ],
    times: [
      type: {:in, [:sender, :local]},
      default: :sender,
      doc:
        "`:sender` keeps the sender's times; `:local` converts them to this machine's clock by the offset that the" <>
          " link estimates."
    ],
    window: [
      type: :pos_integer,
      doc:
        "The maximum number of bytes buffered here; default 4 MiB, or 256 KiB for a lossy policy."
    ],
    name: [type: :string, doc: "The component's name."]
  ]

  @enforce_keys [:pid, :pipeline, :address, :opts]
  defstruct [:pid, :pipeline, :address, :opts]

  @typedoc "A link that a pipeline has opened."
  @type t :: %__MODULE__{}

  @doc """
  Serves recordings: a path (all versions of its name, one after the other), an open store, or a map of names to these.
  During `build`, also serves the result of `Situ.Store.create/4` and live streams: a stream or
  `[{"name", stream}, ...]`, whose last minute is kept in memory. A server of live streams ends with their pipeline, and
  any other server ends with the pipeline of the option `pipeline: p`.

  Listens on 127.0.0.1 unless `interface:` is given, and then requires a token or a certificate.

  #{Options.docs(ServerConfig.options())}
  """
  @spec serve(ServerConfig.served() | %{String.t() => ServerConfig.served()}, keyword()) ::
          {:ok, pid()} | {:error, Error.t()}
  defdelegate serve(source, opts \\ []), to: ServerConfig

  @doc """
  Opens a link to a server during `build`; `stream/3` then adds its streams.

  Raises the `Situ.Error` if the server refuses the link (`:wrong_token`, `:wrong_version`, `:no_recording`) or is not
  a link server (`:no_link`). If the server cannot be reached, keeps trying until the pipeline ends.

  #{Options.docs(@link_options)}
  """
  @spec open(Pipeline.t(), String.t(), keyword()) :: t()
  def open(%Situ.Graph.Handle{} = p, address, opts \\ []) do
    opts = Options.validate!(opts, @link_options)
    address = address |> Address.parse() |> Error.unwrap!()
    position = if opts[:from] == :resume, do: opts[:position] || Position.default_path(address)
    if position, do: position |> Position.load() |> Error.unwrap!()

    {:ok, pid} =
      Connection.start(
        address,
        %{
          token: Handshake.hide_token(opts[:token]),
          tls: opts[:tls],
          now: opts[:now] || (&Situ.Time.now/0),
          position: position,
          save_every: opts[:save_every]
        },
        p.pid
      )

    :ok = Pipeline.on(p, :completed, fn _report -> Connection.close(pid) end, pid)
    :ok = Pipeline.on(p, :abandoned, fn _error -> Connection.close(pid) end, pid)

    link = %__MODULE__{
      pid: pid,
      pipeline: p,
      address: address,
      opts: Keyword.put(opts, :position, position)
    }

    case Connection.await_catalogue(pid, opts[:wait]) do
      {:error, %{code: code} = error} when code not in [:unreachable, :link_lost] -> raise error
      _ -> link
    end
  end

  @doc "Returns the names and types of the streams that the server has announced so far."
  @spec streams(t()) :: %{String.t() => Situ.Type.t()}
  def streams(%__MODULE__{pid: pid}) do
    case Connection.await_catalogue(pid, 0) do
      {:ok, catalogue} -> Map.new(catalogue, fn {name, text} -> {name, parse_type(text)} end)
      {:error, _} -> %{}
    end
  end

  defp parse_type(text) do
    case TypeName.parse_type(text) do
      {:ok, type} -> type
      :error -> :any
    end
  end

  @doc """
  Adds a stream of the link during `build`. If the server does not have the stream yet, it begins when the server does;
  `type:` is then required.

  #{Options.docs(@stream_options)}
  """
  @spec stream(t(), String.t(), keyword()) :: Situ.Stream.t()
  def stream(%__MODULE__{} = link, name, opts \\ []) when is_binary(name) do
    opts = Options.validate!(opts, @stream_options)
    type = opts[:type] || known_type(link, name)
    policy = opts[:policy] || Delivery.unlimited()

    request = %{
      datagram: datagram_size(opts[:datagrams], policy),
      name: name,
      from: resolve_start(opts[:from] || link.opts[:from], link, name),
      policy: encode_policy(policy),
      priority: opts[:priority],
      window: opts[:window] || if(Delivery.lossy?(policy), do: 256 * 1024, else: 4 * 1024 * 1024),
      times: opts[:times]
    }

    Situ.source(link.pipeline, Source,
      link: link.pid,
      request: request,
      type: opts[:type] || :any,
      outputs: [out: type],
      name: opts[:name] || String.replace(name, ".", " ")
    )
  end

  defp datagram_size(false, _policy), do: nil

  defp datagram_size(size, policy) do
    unless Delivery.lossy?(policy) do
      raise Error.new(:bad_option, "datagrams: needs a lossy policy:",
              why: "lost datagrams are not sent again",
              fix:
                "add policy: Situ.Delivery.latest() (or max_queue, max_latency), or remove datagrams:"
            )
    end

    if size == true, do: 1_200, else: size
  end

  defp known_type(link, name) do
    streams = streams(link)

    case streams do
      %{^name => type} ->
        type

      _ ->
        fix =
          case Options.nearest_name(name, Map.keys(streams)) do
            nil ->
              "give its type: to wait for the stream"

            nearest ->
              "did you mean #{inspect(nearest)}? Give type: to wait for a stream of another name"
          end

        raise Error.new(
                :no_stream,
                "no stream #{inspect(name)} at #{Address.to_string(link.address)}",
                why: if(streams == %{}, do: "the server has not responded yet", else: nil),
                fix: fix
              )
    end
  end

  defp resolve_start(time, _link, _name) when is_integer(time), do: {:at, time}
  defp resolve_start(start, _link, _name) when start in [:now, :start], do: start

  defp resolve_start(:resume, link, name) do
    case link.opts[:position] && Position.load(link.opts[:position]) do
      {:ok, %{^name => time}} -> {:after, time}
      {:error, error} -> raise error
      _ -> :start
    end
  end

  defp resolve_start({:after, recording}, _link, name) do
    path = Path.expand(recording)

    case RecordingVersions.with_messages(Path.dirname(path), Folder.store_name(path), name) do
      nil -> :start
      {_version, _store, info} -> {:after, info.last}
    end
  end

  defp encode_policy(%{max_queue: 1}), do: "latest"
  defp encode_policy(%{max_queue: n}) when is_integer(n), do: %{"max_queue" => n}
  defp encode_policy(%{max_latency: d}) when is_integer(d), do: %{"max_latency" => d}
  defp encode_policy(_lossless), do: nil

  @doc """
  Confirms the messages of a link's stream that the pipeline has finished processing. `stream` is the result of
  processing the stream `name`, with the same originating times. The stored position for `from: :resume` is then the
  time of its last message, so a kill at any moment loses nothing, and messages in flight are sent again. Without this
  function, the position is the time of the last message passed to the pipeline.

  Requires the sender's times (`times: :sender`). Returns the stream.

      link = Situ.Link.open(p, "situ://lab1/lobby", from: :resume)
      link |> Situ.Link.stream("imu") |> Situ.each(&keep/1) |> Situ.Link.confirm(link, "imu")
  """
  @spec confirm(Situ.Stream.t(), t(), String.t()) :: Situ.Stream.t()
  def confirm(%Situ.Stream{} = stream, %__MODULE__{} = link, name) do
    :ok = Connection.enable_confirmation(link.pid, name)

    Situ.via(stream, ConfirmComponent,
      default_name: "Confirm " <> String.replace(name, ".", " "),
      link: link.pid,
      stream: name,
      policy: Delivery.unlimited()
    )

    stream
  end

  @doc """
  Returns the state of the link:

  | key | value |
  |---|---|
  | `connected?`, `connections` | whether it is connected now, and how often it has connected |
  | `error` | why it is not connected, or `nil` |
  | `bytes` | the bytes received |
  | `offset`, `uncertainty`, `drift` | how far the other clock is ahead and how exact that is (ns), and how fast it changes |
  | `round_trip` | the quickest of the recent round trips, ns |
  | `streams` | for each stream whether it was `found?`, how many messages were `received` and `lost`, its `position`, its `lag` (ns) ... |
  """
  @spec info(t()) :: map()
  def info(%__MODULE__{pid: pid}), do: Connection.link_info(pid)

  @doc """
  Returns the links that pipelines of this node have open: the `address`, and the result of `info/1` for each.
  """
  @spec links() :: [map()]
  def links do
    links = Registry.select(Situ.Link.Registry, [{{:_, :"$1", :"$2"}, [], [{{:"$1", :"$2"}}]}])

    for {pid, address} <- links,
        info <- link_info(pid),
        do: Map.put(info, :address, address)
  end

  # The link may be closing at this moment.
  defp link_info(pid) do
    [Connection.link_info(pid)]
  catch
    :exit, _ -> []
  end

  @doc """
  Returns the addresses of the recordings of a server (`situ://lab1`), sorted. An address that names a recording is
  returned as it is. `opts` are `:token` and `:tls`, see "Recordings on other machines" above.

  Errors: `:bad_address`, `:unreachable`, `:no_link` (the server is something else), `:wrong_token`.
  """
  @spec list_recordings(String.t(), keyword()) :: {:ok, [String.t()]} | {:error, Error.t()}
  def list_recordings(address, opts \\ []) do
    with {:ok, %{name: ""} = parsed} <- Address.parse(address),
         {:ok, access} <- Access.new(parsed, opts),
         {:ok, names} <- Dialer.list_recordings(parsed, access) do
      {:ok, for(name <- Enum.sort(names), do: Address.to_string(%{parsed | name: name}))}
    else
      {:ok, %Address{}} -> {:ok, [address]}
      {:error, error} -> {:error, error}
    end
  end

  @doc """
  Returns the known servers: the configured names (`config :situ_link, names: %{...}`), and the endpoints that other
  processes at a rendezvous offer (`members` are the processes of `Situ.Link.Rendezvous.join/2`).

      iex> Application.put_env(:situ_link, :names, %{"lab1" => "situ://10.0.0.3"})
      iex> Situ.Link.peers()
      [%{name: "lab1", address: "situ://10.0.0.3", streams: []}]
      iex> Application.delete_env(:situ_link, :names)
      :ok
  """
  @spec peers([pid()]) :: [
          %{name: String.t(), address: String.t(), streams: [{String.t(), String.t()}]}
        ]
  def peers(members \\ []) do
    configured =
      for {name, address} <- Application.get_env(:situ_link, :names, %{}),
          do: %{name: name, address: address, streams: []}

    announced =
      for member <- members,
          %{name: name, endpoints: endpoints} <- Rendezvous.peers(member),
          {:address, address, streams} <- endpoints,
          Address.address?(address),
          do: %{name: name, address: address, streams: streams}

    configured ++ announced
  end

  # The options contain the token.
  defimpl Inspect do
    def inspect(%{address: address}, _opts),
      do: "#Situ.Link<#{Kernel.inspect(Situ.Link.Address.to_string(address))}>"
  end
end
