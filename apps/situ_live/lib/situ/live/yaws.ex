defmodule Situ.Live.Yaws do
  @moduledoc false
  # The only module that manages Yaws: one embedded instance per VM, to which servers (one port each) are added.
  # Requests come in through `Situ.Live.Yaws.Dispatch`, WebSockets through `Situ.Live.Yaws.WebSocket`.
  # See docs/adr/0070-yaws-is-embedded-behind-its-dispatch-module.md.
  use Supervisor

  require Logger
  alias Situ.Error

  @compile {:no_warn_undefined, [:yaws, :yaws_api, :yaws_sup, :yaws_config, :yaws_log]}

  # Closes idle keep-alive connections, and connections that take longer than this for one line of a request's head.
  @idle_ms 15_000
  @send_timeout_ms 15_000
  @max_connections 2_000
  # Yaws reads a head line by line, up to a thousand lines of 16 KiB, into the heap of the connection's process; each
  # byte takes sixteen bytes of heap. This number of words fits a head of about 128 KiB; a larger head ends the
  # connection. `Situ.Live.Yaws.Dispatch` lifts the limit once the head is read.
  @head_heap %{size: 1_000_000, kill: true, error_logger: false}

  @spec start_link(term()) :: Supervisor.on_start()
  def start_link(_), do: Supervisor.start_link(__MODULE__, [], name: __MODULE__)

  @impl true
  def init(_) do
    case load_yaws() do
      :ok ->
        :logger.add_primary_filter(__MODULE__, {&__MODULE__.filter_log/2, []})
        configure = %{id: :configure, start: {__MODULE__, :configure, []}}
        specs = :yaws_sup.child_specs() ++ [configure]
        {:ok, {%{strategy: :one_for_all, intensity: 10, period: 60}, specs}}

      {:error, error} ->
        Logger.warning(Exception.message(error))
        Supervisor.init([], strategy: :one_for_one)
    end
  end

  @doc false
  def configure do
    settings = [
      keepalive_timeout: @idle_ms,
      max_connections: @max_connections,
      logdir: unused_folder(),
      process_options: [max_heap_size: @head_heap],
      flags: [copy_errlog: false, fail_on_bind_err: false]
    ]

    without_generated_code(fn ->
      :ok = :yaws_api.setconf(:yaws.create_gconf(settings, ~c"situ"), [])
    end)

    :ignore
  end

  # Yaws would write a module to a file with a predictable name in the shared temporary folder, then compile and load
  # it. Other users of the machine could place their own file there. It is therefore given a private folder in which
  # it cannot write that file, and falls back to the module that it already has.
  defp without_generated_code(fun) do
    folder = Error.unwrap!(Situ.TempFolder.create_folder("yaws"))
    previous = System.get_env("YAWSHOME")
    File.mkdir_p!(Path.join(folder, ".yaws/yaws/situ/yaws_dynopts.erl"))
    System.put_env("YAWSHOME", folder)

    try do
      fun.()
    after
      if previous, do: System.put_env("YAWSHOME", previous), else: System.delete_env("YAWSHOME")
      Situ.TempFolder.remove_folder(folder)
    end
  end

  # Drops Yaws's messages about listening and stopping, which are meant for its own operators, and its messages about
  # misbehaving clients, who could fill the log with them. Yaws's own errors pass.
  @doc false
  def filter_log(%{level: level} = event, _) do
    cond do
      __MODULE__ not in Process.get(:"$ancestors", []) -> :ignore
      level in [:info, :notice] -> :stop
      client_error?(event) -> :stop
      true -> :ignore
    end
  end

  # `without_generated_code/1` causes the message "Cannot write".
  @client_errors [
                   "Unhandled reply",
                   "Invalid",
                   "Expected origin",
                   "Unsupported",
                   "No key",
                   "Unmasked"
                 ] ++
                   ["Payload length", "Abnormal Closure", "get_client_data", "Cannot write"]

  defp client_error?(%{msg: {:report, %{label: {:error_logger, _}, format: format}}}),
    do: String.starts_with?(to_string(format), @client_errors)

  defp client_error?(_), do: false

  @doc "Opens a port; `ref` is passed to the dispatcher with every request."
  @spec open_listener(term(), :inet.ip_address(), :inet.port_number(), keyword()) ::
          {:ok, term()} | {:error, Error.t()}
  def open_listener(ref, ip, port, tls) do
    options =
      [
        port: port,
        listen: ip,
        servername: ~c"situ-#{port}",
        opaque: ref,
        dispatchmod: Situ.Live.Yaws.Dispatch,
        flags: [access_log: false, auth_log: false],
        soptions: [
          listen_opts: [
            backlog: 1024,
            nodelay: true,
            send_timeout: @send_timeout_ms,
            send_timeout_close: true
          ]
        ]
      ] ++ tls_options(tls)

    with :ok <- load_yaws(),
         sconf = :yaws.create_sconf(unused_folder(), options),
         :ok <- check_port_free(ip, port) do
      case :gen_server.call(:yaws_server, {:add_sconf, -1, sconf}, 90_000) do
        {:ok, ^sconf} -> {:error, port_error(port, :eaddrinuse)}
        {:ok, listener} -> {:ok, listener}
        {:error, reason} -> {:error, port_error(port, reason)}
      end
    end
  end

  # Yaws requires a document folder and a log folder, but is configured to serve no files and to write no logs.
  defp unused_folder, do: String.to_charlist(Application.app_dir(:situ_live, "ebin"))

  @doc "Closes a port. This takes Yaws a second, or up to a minute while it handles requests."
  @spec close_listener(term()) :: :ok
  def close_listener(sconf) do
    :gen_server.call(:yaws_server, {:delete_sconf, sconf}, 90_000)
    :ok
  catch
    :exit, _ -> :ok
  end

  # Yaws would turn a port that it already serves into a virtual host of that port, and would use one port for every
  # port 0. The port is therefore checked first.
  defp check_port_free(ip, port) do
    options =
      [:binary, ip: ip, reuseaddr: true] ++ if(tuple_size(ip) == 8, do: [:inet6], else: [])

    case :gen_tcp.listen(port, options) do
      {:ok, socket} -> :gen_tcp.close(socket)
      {:error, reason} -> {:error, port_error(port, reason)}
    end
  end

  @doc "Returns a port that is currently free."
  @spec free_port(:inet.ip_address()) :: {:ok, :inet.port_number()} | {:error, Error.t()}
  def free_port(ip) do
    options = [ip: ip] ++ if(tuple_size(ip) == 8, do: [:inet6], else: [])

    with {:ok, socket} <- :gen_tcp.listen(0, options),
         {:ok, port} <- :inet.port(socket) do
      :gen_tcp.close(socket)
      {:ok, port}
    else
      {:error, reason} -> {:error, port_error(0, reason)}
    end
  end

  defp port_error(port, :eaddrinuse) do
    Error.new(:port_in_use, "port #{port} is in use",
      fix: "stop the program that uses it, or choose another port"
    )
  end

  defp port_error(port, reason) do
    Error.new(:cannot_listen, "cannot listen on port #{port}: #{inspect(reason)}")
  end

  defp tls_options(nil), do: []

  defp tls_options(tls) do
    [ssl: [{:certfile, to_charlist(tls[:certfile])}, {:keyfile, to_charlist(tls[:keyfile])}]]
  end

  defp load_yaws do
    case Application.load(:yaws) do
      :ok -> set_embedded()
      {:error, {:already_loaded, :yaws}} -> set_embedded()
      {:error, _} -> find_and_load()
    end
  end

  # Searches like mix.exs, for a VM that was not started by Mix or from a release.
  defp find_and_load do
    erlang = to_string(:code.lib_dir())

    [erlang, Path.dirname(erlang), erlang |> Path.dirname() |> Path.dirname()]
    |> Enum.flat_map(&Path.wildcard(Path.join(&1, "yaws{,-*}/ebin")))
    |> Enum.max(fn -> nil end)
    |> case do
      nil ->
        {:error,
         Error.new(:no_web_server, "the web server Yaws is not installed",
           fix: "install the package erlang-yaws, or put the Yaws folder into #{erlang}"
         )}

      ebin ->
        Code.append_path(ebin)
        :ok = Application.load(:yaws)
        set_embedded()
    end
  end

  defp set_embedded do
    Application.put_env(:yaws, :embedded, true)
    Application.put_env(:yaws, :id, "situ")
  end
end
