defmodule Situ.Infer.Http do
  @moduledoc false
  # Sends one request over HTTP/1.1 and passes the response on as it arrives, which streaming
  # services require.
  #
  # A request runs in the calling process and ends with it; killing that process closes the
  # connection. Certificates are verified against the system's authorities (or those in
  # `cacertfile:`), including the host name in the URL. Headers may contain secrets, so errors,
  # logs and process states never contain headers.
  #
  # OTP's `httpc` is not used because it keeps the complete body of every unsuccessful response,
  # however long, and logs the request headers if its process crashes ([ADR
  # 0062](docs/adr/0062-our-own-http-client-for-streaming.md)).
  alias Situ.Error
  alias Situ.Infer.Http.Decoder

  @schema [
    connect_timeout: [
      type: :pos_integer,
      default: 5_000,
      doc: "The time limit for connecting, in ms."
    ],
    idle_timeout: [
      type: :pos_integer,
      default: 30_000,
      doc: "The time limit without any received data, in ms."
    ],
    timeout: [
      type: :pos_integer,
      default: 120_000,
      doc: "The time limit for the whole request, in ms."
    ],
    cacertfile: [
      type: {:optional, :string},
      default: nil,
      doc: "A PEM file of trusted authorities; `nil` uses the system's."
    ]
  ]

  @type header :: {String.t(), String.t()}
  @type event :: {:status, 100..999, [header()]} | {:data, binary()}
  @type url :: %{
          scheme: :http | :https,
          host: String.t(),
          port: :inet.port_number(),
          path: String.t()
        }

  @doc "Returns the schema of the options, for modules that pass them on."
  @spec schema() :: Situ.Options.schema()
  def schema, do: @schema

  @doc """
  Parses a URL. A URL with a user or password is rejected, since URLs end up in logs.

      iex> Situ.Infer.Http.parse_url("https://models.example/v1")
      {:ok, %{scheme: :https, host: "models.example", port: 443, path: "/v1"}}
      iex> {:error, error} = Situ.Infer.Http.parse_url("https://me:secret@models.example/v1")
      iex> {error.code, error.what =~ "secret"}
      {:bad_url, false}
  """
  @spec parse_url(String.t()) :: {:ok, url()} | {:error, Error.t()}
  def parse_url(text) do
    case URI.new(text) do
      {:ok, %URI{userinfo: nil, scheme: scheme, host: host, port: port} = uri}
      when scheme in ["http", "https"] and is_binary(host) and host != "" ->
        query = if uri.query, do: "?" <> uri.query, else: ""

        {:ok,
         %{
           scheme: if(scheme == "http", do: :http, else: :https),
           host: host,
           port: port,
           path: (uri.path || "/") <> query
         }}

      {:ok, %URI{userinfo: user}} when user != nil ->
        bad_url(
          "a URL must not contain a user or password",
          "name the variable that holds the key"
        )

      _ ->
        bad_url(
          "#{inspect(text, printable_limit: 80)} is not the URL of a service",
          "write it as https://HOST/PATH"
        )
    end
  end

  defp bad_url(what, fix), do: {:error, Error.new(:bad_url, what, fix: fix)}

  @doc "Returns whether the URL names this machine, so that no other machine can eavesdrop."
  @spec local_host?(url()) :: boolean()
  def local_host?(%{host: host}),
    do: host in ["localhost", "::1"] or match?({:ok, {127, _, _, _}}, parse_ipv4(host))

  defp parse_ipv4(host), do: :inet.parse_ipv4strict_address(String.to_charlist(host))

  @doc """
  Sends the request. `fun` receives `{:status, status, headers}`, then `{:data, bytes}` as data arrive, with the
  accumulator, and returns `{:cont, acc}` or `{:halt, acc}`. Returns the last accumulator. Redirects are not followed.

  #{Situ.Options.docs(@schema)}
  """
  @spec request(
          :get | :post,
          String.t(),
          [header()],
          iodata(),
          keyword(),
          (event(), acc -> {:cont, acc} | {:halt, acc}),
          acc
        ) :: {:ok, acc} | {:error, Error.t(), acc}
        when acc: term()
  def request(method, url, headers, body, opts, fun, acc) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, url} <- parse_url(url),
         :ok <- check_headers(headers),
         until = now_ms() + opts[:timeout],
         {:ok, socket} <- connect_socket(url, opts, until) do
      try do
        with :ok <- send_all(socket, encode_request(method, url, headers, body), url) do
          peer = %{socket: socket, url: url, idle: opts[:idle_timeout], until: until}
          receive_all(peer, Decoder.new(), fun, acc)
        end
      after
        close_socket(socket)
      end
    end
    |> case do
      {:error, error} -> {:error, error, acc}
      result -> result
    end
  end

  # A line break in a value could inject another header or request.
  defp check_headers(headers) do
    if Enum.all?(headers, fn {name, value} -> not (name <> value =~ ~r/[\r\n\0]/) end),
      do: :ok,
      else:
        {:error,
         Error.new(:bad_header, "a header of the request contains a line break",
           fix: "remove the line break from the variable that holds the key"
         )}
  end

  defp encode_request(method, url, headers, body) do
    size = IO.iodata_length(body)
    verb = if method == :get, do: "GET", else: "POST"
    host = if String.contains?(url.host, ":"), do: "[#{url.host}]", else: url.host

    [
      [verb, " ", url.path, " HTTP/1.1\r\nhost: ", host, ":#{url.port}\r\n"],
      ["connection: close\r\nuser-agent: situ\r\ncontent-length: #{size}\r\n"],
      for({name, value} <- headers, do: [name, ": ", value, "\r\n"]),
      "\r\n",
      body
    ]
  end

  defp connect_socket(url, opts, until) do
    wait = min(opts[:connect_timeout], remaining_ms(until))
    # By default, each read takes at most 1,460 bytes.
    plain = [:binary, active: false, packet: :raw, buffer: 65_536]
    plain = [send_timeout: opts[:idle_timeout]] ++ plain
    host = String.to_charlist(url.host)

    case url.scheme do
      :http -> :gen_tcp.connect(host, url.port, plain ++ address_family(url), wait)
      :https -> connect_tls(host, url, plain ++ address_family(url), opts, wait)
    end
    |> case do
      {:ok, socket} -> {:ok, {transport_module(url), socket}}
      {:error, %Error{}} = error -> error
      {:error, reason} -> {:error, connection_error(url, reason)}
    end
  end

  defp transport_module(%{scheme: :http}), do: :gen_tcp
  defp transport_module(%{scheme: :https}), do: :ssl

  defp address_family(%{host: host}), do: if(String.contains?(host, ":"), do: [:inet6], else: [])

  defp connect_tls(host, url, plain, opts, wait) do
    with {:ok, trusted} <- trust_options(opts[:cacertfile]) do
      options =
        [
          verify: :verify_peer,
          depth: 4,
          versions: [:"tlsv1.3", :"tlsv1.2"],
          customize_hostname_check: [match_fun: &hostname_matches?/2],
          log_level: :none
        ] ++ trusted

      case :ssl.connect(host, url.port, plain ++ options, wait) do
        {:error, {:tls_alert, {alert, _}}} -> {:error, not_trusted(url, alert)}
        result -> result
      end
    end
  end

  # OTP's match function does not match IP addresses in a certificate with a host given as text.
  defp hostname_matches?({:dns_id, host}, {:iPAddress, bytes}) do
    case :inet.parse_strict_address(host) do
      {:ok, address} -> address_bytes(address) == IO.iodata_to_binary(bytes)
      _ -> false
    end
  end

  defp hostname_matches?(wanted, presented),
    do: :public_key.pkix_verify_hostname_match_fun(:https).(wanted, presented)

  defp address_bytes({_, _, _, _} = ip), do: ip |> Tuple.to_list() |> :binary.list_to_bin()
  defp address_bytes(ip), do: for(part <- Tuple.to_list(ip), into: "", do: <<part::16>>)

  defp trust_options(nil) do
    {:ok, [cacerts: :public_key.cacerts_get()]}
  rescue
    _ ->
      {:error,
       Error.new(:not_trusted, "this system has no certificates of trusted authorities",
         fix: "install them: apt-get install ca-certificates"
       )}
  end

  defp trust_options(file) do
    if File.regular?(file),
      do: {:ok, [cacertfile: String.to_charlist(file)]},
      else: {:error, Error.new(:not_trusted, "cacertfile: file #{file} does not exist")}
  end

  defp not_trusted(url, alert) do
    Error.new(:not_trusted, "#{format_origin(url)} could not prove its identity: #{alert}",
      why: "its certificate must be signed by a trusted authority for exactly this name",
      fix: "check the URL; for a private server, give its authority as cacertfile:"
    )
  end

  defp connection_error(url, :timeout),
    do: timeout_error(url, "did not accept the connection in time")

  defp connection_error(url, reason) do
    Error.new(:no_connection, "cannot reach #{format_origin(url)}: #{format_reason(reason)}",
      fix: "check the URL, and that the service is running"
    )
  end

  defp format_reason(reason) when is_atom(reason), do: :inet.format_error(reason)
  defp format_reason(reason), do: inspect(reason, limit: 5, printable_limit: 80)

  defp send_all({transport, socket}, bytes, url) do
    case transport.send(socket, bytes) do
      :ok -> :ok
      # The service may already have responded and closed the connection; its response explains why.
      {:error, :closed} -> :ok
      {:error, :timeout} -> {:error, timeout_error(url, "did not accept the request in time")}
      {:error, reason} -> {:error, connection_error(url, reason)}
    end
  end

  defp receive_all(%{socket: {transport, socket}, url: url} = peer, decoder, fun, acc) do
    case transport.recv(socket, 0, min(peer.idle, remaining_ms(peer.until))) do
      {:ok, bytes} ->
        with {:ok, events, decoder} <- wrap_decoder_error(Decoder.push(decoder, bytes), url, acc) do
          case emit_events(events, fun, acc) do
            {:cont, acc} -> receive_all(peer, decoder, fun, acc)
            {:halt, acc} -> {:ok, acc}
          end
        end

      {:error, :timeout} ->
        {:error, timeout_error(url, "stopped sending data"), acc}

      {:error, _closed} ->
        with :ok <- wrap_decoder_error(Decoder.close(decoder), url, acc), do: {:ok, acc}
    end
  end

  defp emit_events([], _fun, acc), do: {:cont, acc}
  defp emit_events([:done | _], _fun, acc), do: {:halt, acc}

  defp emit_events([event | events], fun, acc) do
    case fun.(event, acc) do
      {:cont, acc} -> emit_events(events, fun, acc)
      {:halt, acc} -> {:halt, acc}
    end
  end

  defp wrap_decoder_error({:error, :cut_off}, url, acc) do
    {:error,
     Error.new(
       :cut_off,
       "#{format_origin(url)} closed the connection before the response was complete",
       fix: "try again, and check the service's log"
     ), acc}
  end

  defp wrap_decoder_error({:error, why}, url, acc) do
    {:error,
     Error.new(:bad_response, "#{format_origin(url)} did not return a valid HTTP response",
       why: why,
       fix: "check the URL; another program may be listening there"
     ), acc}
  end

  defp wrap_decoder_error(fine, _url, _acc), do: fine

  defp timeout_error(url, what),
    do: Error.new(:timeout, "#{format_origin(url)} #{what}", fix: "increase the timeouts")

  defp format_origin(url), do: "#{url.scheme}://#{url.host}:#{url.port}"
  defp close_socket({transport, socket}), do: transport.close(socket)
  defp now_ms, do: System.monotonic_time(:millisecond)
  defp remaining_ms(until), do: max(until - now_ms(), 0)
end
