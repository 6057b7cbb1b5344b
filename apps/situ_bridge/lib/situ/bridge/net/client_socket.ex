defmodule Situ.Bridge.Net.ClientSocket do
  @moduledoc false
  # A plain or TLS connection to a server, with one interface to both. Bytes from the server arrive as
  # `{:tcp | :ssl, socket, bytes}`, for `match_message/2`.

  @options [
    tls: [
      type: {:or, [:boolean, :keyword]},
      default: false,
      doc:
        "Connects with TLS, and only to a server whose certificate is valid for its name. `true` trusts the " <>
          "system's authorities. A list sets `authorities:` (a file that lists them), `name:` (the name in the " <>
          "certificate, if different), and `certificate:` and `key:` (files, if the server requires them of clients)."
    ]
  ]
  @tls_keys [:authorities, :name, :certificate, :key]

  @type t :: {:gen_tcp, :gen_tcp.socket()} | {:ssl, :ssl.sslsocket()}
  @type tls :: boolean() | keyword()

  @doc "Returns the TLS option of clients."
  @spec tls_options() :: Situ.Options.schema()
  def tls_options, do: @options

  @doc "Connects with a socket in active-once mode. Errors come from `:gen_tcp` and `:ssl`, or are sentences."
  @spec connect(String.t(), :inet.port_number(), tls(), keyword()) ::
          {:ok, t()} | {:error, term()}
  def connect(host, port, tls, options) do
    options = [:binary, active: :once] ++ Situ.TcpKeepalive.options() ++ options

    if tls in [nil, false] do
      with {:ok, tcp} <- :gen_tcp.connect(String.to_charlist(host), port, options, 2_000),
           do: {:ok, {:gen_tcp, tcp}}
    else
      connect_tls(host, port, if(tls == true, do: [], else: tls), options)
    end
  end

  defp connect_tls(host, port, tls, options) do
    with :ok <- check_options(tls),
         {:ok, authorities} <- authority_options(tls[:authorities]),
         {:ok, _} <- Application.ensure_all_started(:ssl),
         ssl_options =
           authorities ++ client_certificate(tls) ++ verify_options(tls[:name] || host),
         {:ok, ssl} <-
           :ssl.connect(String.to_charlist(host), port, options ++ ssl_options, 5_000),
         do: {:ok, {:ssl, ssl}}
  end

  defp check_options(tls) do
    case Keyword.keys(tls) -- @tls_keys do
      [] ->
        :ok

      [key | _] ->
        {:error, "tls: has no option #{inspect(key)}; its options are #{inspect(@tls_keys)}"}
    end
  end

  defp authority_options(nil) do
    {:ok, [cacerts: :public_key.cacerts_get()]}
  rescue
    _ -> {:error, "this system has no list of authorities; pass tls: [authorities: FILE]"}
  end

  defp authority_options(file) do
    if File.regular?(file),
      do: {:ok, [cacertfile: file]},
      else: {:error, "#{file}, the file of trusted authorities, does not exist"}
  end

  defp client_certificate(tls) do
    case {tls[:certificate], tls[:key]} do
      {nil, nil} -> []
      {certificate, nil} -> [certfile: certificate]
      {certificate, key} -> [certfile: certificate, keyfile: key]
    end
  end

  defp verify_options(name) do
    [
      verify: :verify_peer,
      depth: 5,
      server_name_indication: String.to_charlist(name),
      customize_hostname_check: [match_fun: &host_matches?/2],
      log_level: :error
    ]
  end

  # OTP's match function does not match IP addresses in the certificate with a host given as text.
  defp host_matches?({:dns_id, host}, {:iPAddress, bytes}) do
    case :inet.parse_strict_address(host) do
      {:ok, {a, b, c, d}} ->
        IO.iodata_to_binary(bytes) == <<a, b, c, d>>

      {:ok, ip} ->
        IO.iodata_to_binary(bytes) == for(x <- Tuple.to_list(ip), into: "", do: <<x::16>>)

      _ ->
        false
    end
  end

  defp host_matches?(reference, presented),
    do: :public_key.pkix_verify_hostname_match_fun(:https).(reference, presented)

  @spec send_bytes(t(), iodata()) :: :ok | {:error, term()}
  def send_bytes({module, socket}, bytes), do: module.send(socket, bytes)

  @doc "Allows the socket to deliver the next bytes."
  @spec activate_once(t()) :: :ok | {:error, term()}
  def activate_once({:gen_tcp, tcp}), do: :inet.setopts(tcp, active: :once)
  def activate_once({:ssl, ssl}), do: :ssl.setopts(ssl, active: :once)

  @spec close(t()) :: term()
  def close({module, socket}), do: module.close(socket)

  @doc "Returns the bytes or the end of this connection that a process message contains, or `:other`."
  @spec match_message(term(), t() | nil) :: {:ok, binary()} | {:disconnected, term()} | :other
  def match_message({kind, socket, bytes}, {_, socket}) when kind in [:tcp, :ssl],
    do: {:ok, bytes}

  def match_message({kind, socket}, {_, socket}) when kind in [:tcp_closed, :ssl_closed],
    do: {:disconnected, :closed}

  def match_message({kind, socket, reason}, {_, socket}) when kind in [:tcp_error, :ssl_error],
    do: {:disconnected, reason}

  def match_message(_other, _socket), do: :other

  @doc "Describes why a connection failed or ended, for people."
  @spec describe_reason(term()) :: String.t()
  def describe_reason(text) when is_binary(text), do: text
  def describe_reason(:closed), do: "the other side has closed the connection"
  def describe_reason(:etimedout), do: "the other machine no longer answers"

  def describe_reason(reason) when is_atom(reason) do
    case to_string(:inet.format_error(reason)) do
      "unknown POSIX error" <> _ -> inspect(reason)
      text -> text
    end
  end

  def describe_reason({:tls_alert, {_, text}}), do: "TLS: #{text}"
  def describe_reason(other), do: inspect(other, limit: 20)
end
