defmodule Situ.Link.Wire.Socket do
  @moduledoc false
  # Connections that carry frames, over TCP, TLS or Unix sockets.
  alias Situ.Error
  alias Situ.Link.Certificate
  alias Situ.Link.{Address, ServerName}

  @typedoc "A connection or a listener, with the OTP module that owns it."
  @type t :: {:gen_tcp | :ssl, term()}

  # A frame with a larger length field ends the connection before any of its body is read.
  @max_login 64 * 1024
  @send_timeout 30_000

  @frame_options [
    :binary,
    packet: 4,
    active: false,
    packet_size: @max_login,
    send_timeout: @send_timeout,
    send_timeout_close: true
  ]
  # Reading several TLS records at once takes a third of the CPU time. By default, each read takes about a tenth of a
  # record.
  @tls_options [buffer: 65_536]
  # TLS alerts caused by a rejected certificate (a wrong hostname causes `handshake_failure` instead).
  @certificate_alerts ~w(unknown_ca bad_certificate unsupported_certificate certificate_expired certificate_revoked
    certificate_unknown certificate_required)a

  @doc "Opens a listener. Errors: `:address_in_use`, `:bad_address`, `:bad_tls`."
  @spec listen(:unix | :tcp | :tls, keyword()) :: {:ok, t()} | {:error, Error.t()}
  def listen(:unix, opts) do
    path = opts[:path]
    remove_stale_socket(path)

    with {:ok, listener} <-
           :gen_tcp.listen(0, [ifaddr: {:local, path}, backlog: 128] ++ @frame_options),
         :ok <- File.chmod(path, 0o600) do
      {:ok, {:gen_tcp, listener}}
    else
      {:error, reason} -> {:error, cannot_listen(path, reason)}
    end
  end

  def listen(kind, opts) do
    address = "#{opts[:interface]}:#{opts[:port]}"

    with {:ok, ip} <- resolve_ip(opts[:interface]),
         options =
           [address_family(ip), ip: ip, reuseaddr: true, backlog: 128] ++
             internet_options() ++ @frame_options,
         {:ok, listener} <- listen_at(kind, opts, options) do
      {:ok, listener}
    else
      {:error, reason} -> {:error, cannot_listen(address, reason)}
    end
  end

  defp listen_at(:tcp, opts, options),
    do: tag_socket(:gen_tcp, :gen_tcp.listen(opts[:port], options))

  defp listen_at(:tls, opts, options),
    do: tag_socket(:ssl, :ssl.listen(opts[:port], options ++ @tls_options ++ opts[:tls]))

  defp tag_socket(module, {:ok, socket}), do: {:ok, {module, socket}}
  defp tag_socket(_module, error), do: error

  # A killed server leaves its socket file in the folder.
  defp remove_stale_socket(path) do
    case :gen_tcp.connect({:local, path}, 0, [], 1_000) do
      {:ok, socket} ->
        :gen_tcp.close(socket)

      {:error, :econnrefused} ->
        _ = File.rm(path)
        :ok

      {:error, _} ->
        :ok
    end
  end

  defp cannot_listen(address, :eaddrinuse),
    do: Error.new(:address_in_use, "#{address} is in use", fix: "choose another port or path")

  defp cannot_listen(address, reason),
    do:
      Error.new(listen_error_code(reason), "cannot listen on #{address}", why: reason_text(reason))

  defp listen_error_code({:options, _}), do: :bad_tls
  defp listen_error_code(:options), do: :bad_tls
  defp listen_error_code(_reason), do: :bad_address

  @doc "Accepts the next connection, without its TLS handshake (see `complete_handshake/2`)."
  @spec accept(t()) :: {:ok, t()} | {:error, term()}
  def accept({:gen_tcp, listener}), do: tag_socket(:gen_tcp, :gen_tcp.accept(listener))
  def accept({:ssl, listener}), do: tag_socket(:ssl, :ssl.transport_accept(listener))

  @doc "Completes the TLS handshake. The process of the connection calls this, so a slow peer delays no other client."
  @spec complete_handshake(t(), timeout()) :: {:ok, t()} | {:error, term()}
  def complete_handshake({:gen_tcp, _} = socket, _timeout), do: {:ok, socket}

  def complete_handshake({:ssl, socket}, timeout),
    do: tag_socket(:ssl, :ssl.handshake(socket, timeout))

  @doc "Connects to an address. Errors: `:unreachable`, `:wrong_certificate`."
  @spec connect(Address.t(), keyword(), timeout()) :: {:ok, t()} | {:error, Error.t()}
  def connect(%Address{} = address, tls, timeout) do
    case connect_to(address, tls, timeout) do
      {:ok, socket} ->
        check_fingerprint(socket, address)

      {:error, {:tls_alert, {kind, text}} = reason} when kind in @certificate_alerts ->
        {:error, certificate_error(address, to_string(text), reason_text(reason))}

      {:error, {:tls_alert, {:handshake_failure, text}} = reason} ->
        if to_string(text) =~ "hostname_check_failed",
          do: {:error, certificate_error(address, to_string(text), reason_text(reason))},
          else: {:error, unreachable_error(address, reason)}

      {:error, reason} ->
        {:error, unreachable_error(address, reason)}
    end
  end

  defp unreachable_error(address, reason) do
    Error.new(:unreachable, "cannot connect to #{Address.to_string(%{address | name: ""})}",
      why: reason_text(reason),
      fix:
        "check that the server is running, its host and port, and use TLS on both sides or on neither"
    )
  end

  # Trying again cannot help. The alert was sent by the server or describes a problem found on this side.
  defp certificate_error(address, text, why) do
    server = Address.to_string(%{address | name: "", fingerprint: nil})

    cond do
      text =~ "SERVER ALERT" ->
        Error.new(:wrong_certificate, "#{server} rejects this side's certificate",
          why: why,
          fix:
            "give tls: [certfile: ..., keyfile: ...] with a certificate that the server accepts"
        )

      text =~ "hostname_check_failed" ->
        Error.new(
          :wrong_certificate,
          "the certificate of #{server} was issued for a different host",
          why: "it does not name #{address.host}",
          fix: "use a name that the certificate contains, or issue a certificate for this name"
        )

      true ->
        Error.new(:wrong_certificate, "the certificate of #{server} is not trusted",
          why: why,
          fix:
            "open the address that the server prints, which includes the fingerprint, or name the authority that" <>
              " signed the certificate: tls: [cacertfile: ...]"
        )
    end
  end

  defp connect_to(%{transport: :unix, path: path}, _tls, timeout),
    do: tag_socket(:gen_tcp, :gen_tcp.connect({:local, path}, 0, @frame_options, timeout))

  defp connect_to(%{host: host, port: port} = address, tls, timeout) do
    with {:ok, ip} <- resolve_ip(host) do
      options = [address_family(ip)] ++ internet_options() ++ @frame_options

      connect_at(
        address.transport,
        {ip, port},
        host,
        options,
        trust_options(tls, address),
        timeout
      )
    end
  end

  defp internet_options, do: [nodelay: true] ++ Situ.TcpKeepalive.options()

  defp connect_at(:tcp, {ip, port}, _host, options, _tls, timeout),
    do: tag_socket(:gen_tcp, :gen_tcp.connect(ip, port, options, timeout))

  # The certificate must name the requested host, not its resolved address.
  defp connect_at(:tls, {ip, port}, host, options, tls, timeout) do
    name = ServerName.tls_options(host)
    options = options ++ @tls_options ++ Keyword.merge(name, tls)
    tag_socket(:ssl, :ssl.connect(ip, port, options, timeout))
  end

  # By default a server is verified by the system's certificate authorities or, if given, by its fingerprint alone.
  defp trust_options(tls, %{fingerprint: digits}) when digits != nil,
    do: Keyword.merge([verify: :verify_none], tls)

  defp trust_options(tls, %{transport: :tls}) do
    authority? = Enum.any?([:verify, :cacerts, :cacertfile], &Keyword.has_key?(tls, &1))

    if authority?,
      do: Keyword.put_new(tls, :verify, :verify_peer),
      else: system_authorities() ++ tls
  end

  defp trust_options(tls, _address), do: tls

  defp system_authorities do
    [verify: :verify_peer, cacerts: :public_key.cacerts_get()]
  rescue
    # This system has no authorities, so no server is trusted.
    _ -> [verify: :verify_peer, cacerts: []]
  end

  # The handshake has proved that the server owns the key of its certificate.
  defp check_fingerprint(socket, %{fingerprint: nil}), do: {:ok, socket}

  defp check_fingerprint({:ssl, ssl} = socket, %{fingerprint: digits}) do
    case peer_fingerprint(ssl) do
      ^digits ->
        {:ok, socket}

      other ->
        close(socket)

        why =
          if other, do: "its fingerprint is #{other}", else: "the server presented no certificate"

        {:error,
         Error.new(
           :wrong_certificate,
           "the server's certificate does not match the expected fingerprint",
           why: why,
           fix:
             "ask the owner of the server for the address that it prints; otherwise the link may be intercepted"
         )}
    end
  end

  defp peer_fingerprint(ssl) do
    case :ssl.peercert(ssl) do
      {:ok, der} -> Certificate.fingerprint_of(der)
      _ -> nil
    end
  end

  defp resolve_ip(host) do
    chars = String.to_charlist(host)
    with {:error, _} <- :inet.getaddr(chars, :inet), do: :inet.getaddr(chars, :inet6)
  end

  defp address_family(ip) when tuple_size(ip) == 8, do: :inet6
  defp address_family(_ip), do: :inet

  @spec send(t(), iodata()) :: :ok | {:error, term()}
  def send({module, socket}, frame), do: module.send(socket, frame)

  @spec receive(t(), timeout()) :: {:ok, binary()} | {:error, term()}
  def receive({module, socket}, timeout), do: module.recv(socket, 0, timeout)

  @doc """
  Delivers the next frame as a message, `{:tcp | :ssl, socket, body}`, and accepts frames of up to `max` bytes from now
  on.
  """
  @spec enable_frames(t(), pos_integer()) :: :ok | {:error, term()}
  def enable_frames(socket, max), do: set_options(socket, active: :once, packet_size: max)

  @spec activate_once(t()) :: :ok | {:error, term()}
  def activate_once(socket), do: set_options(socket, active: :once)

  defp set_options({:gen_tcp, socket}, opts), do: :inet.setopts(socket, opts)
  defp set_options({:ssl, socket}, opts), do: :ssl.setopts(socket, opts)

  @spec set_owner(t(), pid()) :: :ok | {:error, term()}
  def set_owner({module, socket}, pid), do: module.controlling_process(socket, pid)

  @doc "Sends the remaining data and closes the sending direction."
  @spec finish_sending(t()) :: :ok
  def finish_sending({module, socket}) do
    _ = module.shutdown(socket, :write)
    :ok
  end

  @spec close(t()) :: :ok
  def close({module, socket}) do
    _ = module.close(socket)
    :ok
  end

  @spec port(t()) :: :inet.port_number() | nil
  def port({:gen_tcp, socket}), do: port_number(:inet.sockname(socket))
  def port({:ssl, socket}), do: port_number(:ssl.sockname(socket))

  defp port_number({:ok, {ip, port}}) when is_tuple(ip), do: port
  defp port_number(_local), do: nil

  @doc "Returns the peer's address: an IP, or `:local` for Unix sockets."
  @spec peer_address(t()) :: {:ok, :inet.ip_address() | :local} | {:error, term()}
  def peer_address({:gen_tcp, socket}), do: peer_ip(:inet.peername(socket))
  def peer_address({:ssl, socket}), do: peer_ip(:ssl.peername(socket))

  defp peer_ip({:ok, {:local, _}}), do: {:ok, :local}
  defp peer_ip({:ok, {ip, _port}}), do: {:ok, ip}
  defp peer_ip(error), do: error

  @doc "Returns the local IP address, or `nil` if there is none."
  @spec local_address(t()) :: :inet.ip_address() | nil
  def local_address({:gen_tcp, socket}), do: local_ip(:inet.sockname(socket))
  def local_address({:ssl, socket}), do: local_ip(:ssl.sockname(socket))

  defp local_ip({:ok, {ip, port}}) when is_tuple(ip) and is_integer(port), do: ip
  defp local_ip(_none), do: nil

  @doc "Describes for people why a connection failed."
  @spec reason_text(term()) :: String.t()
  def reason_text({:tls_alert, {_kind, text}}), do: String.trim(to_string(text))
  def reason_text({:options, option}), do: "TLS option #{inspect(option)}"
  def reason_text(:closed), do: "the other side closed the connection"
  def reason_text(:timeout), do: "the connection timed out"
  def reason_text(reason) when is_atom(reason), do: to_string(:inet.format_error(reason))
  def reason_text(reason), do: inspect(reason)
end
