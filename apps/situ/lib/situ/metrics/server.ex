defmodule Situ.Metrics.Server do
  @moduledoc """
  Serves the metrics of a node over HTTP, for nodes without a studio.

      children = [{Situ.Metrics.Server, port: 9568}]

  | path | response |
  |---|---|
  | `/metrics` | `Situ.Metrics` in the text format of Prometheus |
  | `/health` | `200` and `{"status":"ok"}`, or `503` and the pipelines that do not respond |
  | `/health?pipeline=Lobby` | the same, and `503` if this pipeline is not running |

  Everybody who can reach the port can read the metrics, so by default the server listens on this machine only. It uses
  the web server of Erlang/OTP (`inets`).
  """

  @schema [
    port: [
      type: {:range, 0, 65_535},
      default: 9568,
      doc: "The port. With 0, the system selects a free one; see `port/1`."
    ],
    ip: [
      type: :string,
      default: "127.0.0.1",
      doc: ~s(The address to listen on; "0.0.0.0" for all networks.)
    ],
    name: [type: {:optional, :atom}, default: nil, doc: "The name of the process."]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @tries 5

  use GenServer
  alias Situ.{Error, Options}
  alias Situ.Metrics.Handler

  @doc "Starts the server. Errors: a wrong option; `:port_busy` if another program uses the port."
  @spec start_link(keyword()) :: GenServer.on_start() | {:error, Error.t()}
  def start_link(opts \\ []) do
    # The link is made after the start, so that an error is returned and does not end the caller.
    with {:ok, opts} <- Options.validate(opts, @schema),
         name = if(opts[:name], do: [name: opts[:name]], else: []),
         {:ok, pid} <- GenServer.start(__MODULE__, opts, name) do
      Process.link(pid)
      {:ok, pid}
    end
  end

  @doc "Returns the port that the server listens on."
  @spec port(GenServer.server()) :: :inet.port_number()
  def port(server), do: GenServer.call(server, :port)

  @impl true
  def init(opts) do
    # The web server's process is linked, so both end together.
    Process.flag(:trap_exit, true)

    with {:ok, address} <- parse_address(opts[:ip]),
         {:ok, _} <- Application.ensure_all_started(:inets),
         {:ok, pid, port} <- open_port(address, opts[:port], @tries) do
      {:ok, %{httpd: pid, port: port}}
    else
      {:error, error} -> {:stop, error}
    end
  end

  defp parse_address(text) do
    case :inet.parse_address(String.to_charlist(text)) do
      {:ok, address} -> {:ok, address}
      {:error, _} -> {:error, Error.new(:bad_address, "#{inspect(text)} is not an IP address")}
    end
  end

  # The web server does not report the port that the system selects, so a free port is determined before. If another
  # program takes it in the meantime, another port is tried.
  defp open_port(address, 0, tries) do
    {:ok, socket} = :gen_tcp.listen(0, ip: address)
    {:ok, port} = :inet.port(socket)
    :ok = :gen_tcp.close(socket)

    case start_httpd(address, port) do
      {:error, _} when tries > 1 -> open_port(address, 0, tries - 1)
      result -> result
    end
  end

  defp open_port(address, port, _tries), do: start_httpd(address, port)

  defp start_httpd(address, port) do
    # The web server requires a folder, but serves no files.
    folder = :code.lib_dir(:situ)

    config = [
      port: port,
      bind_address: address,
      server_name: 'situ',
      server_root: folder,
      document_root: folder,
      modules: [Handler],
      server_tokens: :none
    ]

    case :inets.start(:httpd, config, :stand_alone) do
      {:ok, pid} -> {:ok, pid, port}
      {:error, reason} -> {:error, listen_error(port, reason)}
    end
  end

  defp listen_error(port, reason) do
    Error.new(:port_busy, "the metrics cannot be served at port #{port}",
      why: inspect(reason, limit: 20),
      fix: "choose another port, or end the program that uses it"
    )
  end

  @impl true
  def handle_call(:port, _from, state), do: {:reply, state.port, state}

  @impl true
  def handle_info({:EXIT, pid, reason}, %{httpd: pid} = state), do: {:stop, reason, state}
  def handle_info({:EXIT, _pid, reason}, state), do: {:stop, reason, state}

  @impl true
  def terminate(_reason, state) do
    monitor = Process.monitor(state.httpd)
    _ = :inets.stop(:stand_alone, state.httpd)

    # The port is free when the web server's process has ended.
    receive do
      {:DOWN, ^monitor, :process, _pid, _reason} -> :ok
    end
  end
end
