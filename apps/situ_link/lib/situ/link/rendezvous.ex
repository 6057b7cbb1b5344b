defmodule Situ.Link.Rendezvous do
  @moduledoc """
  Lets processes on several machines find one another: each announces its endpoints, and learns when others join or
  leave.

      iex> alias Situ.Link.Rendezvous
      iex> {:ok, server} = Rendezvous.serve(port: 0)
      iex> offers = [{:address, "situ://10.0.0.7/robot", [{"imu", ":float"}]}]
      iex> port = Rendezvous.port(server)
      iex> {:ok, robot} = Rendezvous.join("127.0.0.1", port: port, name: "robot", endpoints: offers)
      iex> {:ok, desk} = Rendezvous.join("127.0.0.1", port: port, name: "desk", listener: self())
      iex> receive do {:situ_rendezvous, ^desk, {:added, %{name: "robot", endpoints: endpoints}}} -> endpoints end
      [{:address, "situ://10.0.0.7/robot", [{"imu", ":float"}]}]
      iex> GenServer.stop(robot)
      iex> receive do {:situ_rendezvous, ^desk, event} -> event end
      {:removed, "robot"}

  The protocol is \\psi's, version 2 (`Situ.Link.Rendezvous.Protocol`), so \\psi's processes can take part. When a
  client dies, its processes are removed. A process may change its endpoints (`announce/2`), a silent client does not
  delay the others, and a client that loses its server reconnects after 50 ms to 5 s. If two processes have the same
  name, the others see only the first. The second is notified (`{:taken, name}`, `error/1`), and replaces the first when
  that one leaves. The protocol has no authentication: anyone who can connect can announce, so keep it on the loopback
  address or a separate network. The server disconnects a client that does not send a greeting, or does not complete a
  message, within ten seconds. With 1,000 clients connected, a new client replaces the oldest one that has announced
  nothing.

  If the log already uses a NATS server, no other server is needed.
  `join("nats://lab1:4222,lab2:4222", name: "robot", ...)` does the same over NATS, including its clusters, leaf links,
  accounts and TLS (JetStream is not needed). With `config :situ_link, nats: "nats://lab1:4222"` the names of such
  processes can be used in addresses: `situ://robot` resolves to the first link that the process `robot` offers.
  """

  @serve [
    port: [type: {:range, 0, 65_535}, default: 13_331, doc: "The port; 0 selects any free port."],
    interface: [
      type: :string,
      default: "127.0.0.1",
      doc: "The interface to listen on; \"0.0.0.0\" selects all."
    ],
    deadline: [
      type: :pos_integer,
      default: 10_000,
      doc:
        "The time in ms within which a client must send its greeting, and complete each message that it has begun."
    ]
  ]
  @join [
    port: [type: {:range, 1, 65_535}, default: 13_331, doc: "The server's port."],
    name: [type: :string, required: true, doc: "The name of this process, unique at the server."],
    version: [
      type: :string,
      default: "1",
      doc: "The version of this process, shown to the others."
    ],
    endpoints: [
      type: :list,
      default: [],
      doc:
        "Its endpoints: `{:address, \"situ://lab1/robot\", [{\"imu\", \":float\"}]}` or the other forms in `Protocol`."
    ],
    listener: [
      type: {:optional, :pid},
      default: nil,
      doc:
        "The process that receives `{:situ_rendezvous, member, {:added, process} | {:removed, name}}`."
    ],
    tls: [
      type: {:optional, :keyword},
      default: nil,
      doc: "With `nats://`: options of `:ssl`. If given, TLS is used."
    ],
    beat: [
      type: :pos_integer,
      default: 2_000,
      doc:
        "With `nats://`: ms between heartbeats. A process that misses three of them is removed."
    ]
  ]

  alias Situ.{Error, Options}
  alias Situ.Link.Rendezvous.{Member, NatsMember, Server, Protocol}

  @doc """
  Starts a server that is linked to the caller.

  #{Options.docs(@serve)}
  """
  @spec serve(keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def serve(opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @serve), do: Server.start_link(opts)
  end

  @doc "Returns the port of a server."
  @spec port(pid()) :: :inet.port_number()
  def port(server), do: GenServer.call(server, :port)

  @doc """
  Joins the server on `host`, or NATS (`nats://host:4222`). The member is linked to the caller, and the others remove it
  from their lists when it ends.

  #{Options.docs(@join)}
  """
  @spec join(String.t(), keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def join(host, opts) do
    with {:ok, opts} <- Options.validate(opts, @join) do
      if String.starts_with?(host, "nats://"),
        do: NatsMember.start_link([address: host] ++ opts),
        else: Member.start_link([host: host] ++ opts)
    end
  end

  @doc "Returns the other processes that are currently present."
  @spec peers(pid()) :: [Protocol.process()]
  def peers(member), do: GenServer.call(member, :peers)

  @doc "Replaces the announced endpoints."
  @spec announce(pid(), [Protocol.endpoint()]) :: :ok
  def announce(member, endpoints), do: GenServer.call(member, {:announce, endpoints})

  @doc "Returns why the others cannot see this process (no connection, or its name is taken), or `nil`."
  @spec error(pid()) :: String.t() | nil
  def error(member), do: GenServer.call(member, :error)
end
