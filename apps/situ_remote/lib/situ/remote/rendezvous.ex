defmodule Situ.Remote.Rendezvous do
  @serve [
    port: [type: {:range, 0, 65_535}, default: 13_331, doc: "The port; 0: any free one."],
    interface: [
      type: :string,
      default: "127.0.0.1",
      doc: "Where to listen; \"0.0.0.0\": everywhere."
    ],
    deadline: [
      type: :pos_integer,
      default: 10_000,
      doc: "Ms within which a client must greet, and complete a message that it has begun."
    ]
  ]
  @join [
    port: [type: {:range, 1, 65_535}, default: 13_331, doc: "The server's port."],
    name: [type: :string, required: true, doc: "This process's name, unique at the server."],
    version: [type: :string, default: "1", doc: "This process's version, for the others."],
    endpoints: [
      type: :list,
      default: [],
      doc:
        "Its endpoints: `{:address, \"situ://lab1/robot\", [{\"imu\", \":float\"}]}` and others of `Wire`."
    ],
    listener: [
      type: {:optional, :pid},
      default: nil,
      doc: "Gets `{:situ_rendezvous, member, {:added, process} | {:removed, name}}`."
    ],
    tls: [
      type: {:optional, :keyword},
      default: nil,
      doc: "With `nats://`: options of `:ssl`; TLS is used."
    ],
    beat: [
      type: :pos_integer,
      default: 2_000,
      doc: "With `nats://`: ms between signs of life; a process without three of them is gone."
    ]
  ]

  @moduledoc """
  Where processes on several machines find one another: each announces what it offers, and learns of all others, as
  they come and go.

      iex> alias Situ.Remote.Rendezvous
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

  The protocol is \\psi's, version 2 (`Situ.Remote.Rendezvous.Wire`), so \\psi's processes take part. A client that dies
  takes its processes along, what a process offers may change (`announce/2`), a client that says nothing holds up
  nobody, and one that lost its server comes back after 50 ms to 5 s. Of two processes with one name the others see the
  first; the second is told (`{:taken, name}`, `error/1`), and takes its place when that has gone. The protocol has no
  authentication: everybody who can connect can announce, so leave it on the loopback address or a network of its own.
  The server disconnects a client that does not greet, or does not complete a message, within ten seconds. When there
  are 1,000 clients, a new one takes the place of the oldest client that has announced nothing.

  Where a NATS server is there for the log, no other is needed: `join("nats://lab1:4222,lab2:4222", name: "robot", ...)`
  does the same over it, also over its clusters and leaf links (JetStream is not needed), with its accounts and TLS.
  Then `config :situ_remote, nats: "nats://lab1:4222"` makes the names of such processes names of links: `situ://robot`
  leads to the first link that the process `robot` offers.
  """
  alias Situ.{Error, Options}
  alias Situ.Remote.Rendezvous.{Member, Nats, Server, Wire}

  @doc """
  A server; linked to the caller.

  #{Options.docs(@serve)}
  """
  @spec serve(keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def serve(opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @serve), do: Server.start_link(opts)
  end

  @doc "The port of a server."
  @spec port(pid()) :: :inet.port_number()
  def port(server), do: GenServer.call(server, :port)

  @doc """
  Takes part at the server on `host`, or over NATS (`nats://host:4222`); linked to the caller, and gone from the
  others' lists when it ends.

  #{Options.docs(@join)}
  """
  @spec join(String.t(), keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def join(host, opts) do
    with {:ok, opts} <- Options.validate(opts, @join) do
      if String.starts_with?(host, "nats://"),
        do: Nats.start_link([address: host] ++ opts),
        else: Member.start_link([host: host] ++ opts)
    end
  end

  @doc "The other processes that are there now."
  @spec peers(pid()) :: [Wire.process()]
  def peers(member), do: GenServer.call(member, :peers)

  @doc "Offers these endpoints from now on."
  @spec announce(pid(), [Wire.endpoint()]) :: :ok
  def announce(member, endpoints), do: GenServer.call(member, {:announce, endpoints})

  @doc "Why the others do not see this process now (no connection, or another one has its name), or `nil`."
  @spec error(pid()) :: String.t() | nil
  def error(member), do: GenServer.call(member, :error)
end
