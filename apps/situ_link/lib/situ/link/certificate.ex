defmodule Situ.Link.Certificate do
  @moduledoc false
  # Creates self-issued TLS certificates for servers that were not given one. Browsers ask once
  # whether to trust such a certificate; link clients recognize it by its fingerprint.
  #
  #     {:ok, tls} = Situ.Link.Certificate.ensure_files("/home/ann/.config/situ/tls", ["lab1", "192.168.1.7"])
  #     :ssl.listen(443, tls)
  #
  # To trust the server, a program loads `authority.pem` from the same folder as a certificate
  # authority. The key never leaves the folder, and only its owner can read it. An existing
  # certificate is reused if it names all of these hosts and is valid for at least another week,
  # so that browser exceptions remain valid.
  alias Situ.Error
  require Record

  # These records are copied from public_key.hrl, because Erlang's header files are not installed on every system.
  Record.defrecordp(:extension, :Extension, extnID: nil, critical: :asn1_DEFAULT, extnValue: nil)

  Record.defrecordp(:certificate, :OTPCertificate, [
    :tbsCertificate,
    :signatureAlgorithm,
    :signature
  ])

  Record.defrecordp(
    :tbs,
    :OTPTBSCertificate,
    [:version, :serialNumber, :signature, :issuer, :validity, :subject, :subjectPublicKeyInfo] ++
      [:issuerUniqueID, :subjectUniqueID, :extensions]
  )

  @subject_alternative_name {2, 5, 29, 17}
  @common_name {2, 5, 4, 3}
  @days 825
  @renew_days 7

  @doc """
  Like `ensure_files/2`, for a server on this machine. The folder is in the user's configuration folder. The certificate
  names the machine and the address that the server listens on (all addresses for `0.0.0.0` and `::`).
  """
  @spec ensure_local(:inet.ip_address()) :: {:ok, keyword()} | {:error, Error.t()}
  def ensure_local(ip) do
    {:ok, name} = :inet.gethostname()
    {:ok, interfaces} = :inet.getifaddrs()

    addresses =
      if ip in [{0, 0, 0, 0}, {0, 0, 0, 0, 0, 0, 0, 0}],
        do: for({_, options} <- interfaces, {:addr, address} <- options, do: address),
        else: [ip]

    folder = Path.join(:filename.basedir(:user_config, ~c"situ"), "tls")
    hosts = ["localhost", to_string(name) | Enum.map(addresses, &to_string(:inet.ntoa(&1)))]
    ensure_files(folder, Enum.uniq(hosts))
  end

  @doc "Returns the SHA-256 fingerprint of the first certificate in a PEM file, as 64 hexadecimal digits."
  @spec fetch_fingerprint(Path.t()) :: {:ok, String.t()} | {:error, Error.t()}
  def fetch_fingerprint(certfile) do
    with {:ok, text} <- File.read(certfile),
         {:ok, der} <- first_certificate(text) do
      {:ok, fingerprint_of(der)}
    else
      _ ->
        {:error,
         Error.new(:bad_certificate, "cannot find a certificate in #{certfile}",
           fix: "give a PEM file that begins with the server's certificate"
         )}
    end
  end

  @doc """
  Returns the fingerprint of a DER-encoded certificate.

      iex> Situ.Link.Certificate.fingerprint_of("abc")
      "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
  """
  @spec fingerprint_of(binary()) :: String.t()
  def fingerprint_of(der), do: :sha256 |> :crypto.hash(der) |> Base.encode16(case: :lower)

  @doc "Ensures that `folder` has a certificate for these hosts (names or addresses) and returns options for `:tls`."
  @spec ensure_files(Path.t(), [String.t(), ...]) :: {:ok, keyword()} | {:error, Error.t()}
  def ensure_files(folder, hosts) do
    tls = [certfile: Path.join(folder, "certificate.pem"), keyfile: Path.join(folder, "key.pem")]
    if usable_for?(tls, hosts), do: {:ok, tls}, else: issue_to_folder(folder, tls, hosts)
  end

  defp issue_to_folder(folder, tls, hosts) do
    issued = issue_pem("Situ on #{hd(hosts)}", hosts: hosts)

    with :ok <- File.mkdir_p(folder),
         :ok <- File.chmod(folder, 0o700),
         # The file must be private before the key is written to it.
         :ok <- File.write(tls[:keyfile], ""),
         :ok <- File.chmod(tls[:keyfile], 0o600),
         :ok <- File.write(tls[:keyfile], issued.key),
         :ok <- File.write(Path.join(folder, "authority.pem"), issued.authority),
         :ok <- File.write(tls[:certfile], issued.certificate <> issued.authority) do
      {:ok, tls}
    else
      {:error, reason} ->
        {:error,
         Error.new(
           :cannot_write,
           "cannot write a certificate to #{folder}: #{:file.format_error(reason)}",
           fix: "make the folder writable, or provide your own certificate"
         )}
    end
  end

  @doc """
  Issues a certificate and returns it, its key and the authority that signed it as PEM. The authority signs only this
  certificate; its key is discarded.

  Options: `hosts:` (names or addresses in the certificate) and `days:` (validity, default #{@days}). Validity starts
  yesterday because the clocks of other machines may be slow.

      iex> issued = Situ.Link.Certificate.issue_pem("a lab", hosts: ["lab1"])
      iex> [{:Certificate, der, :not_encrypted}] = :public_key.pem_decode(issued.certificate)
      iex> :public_key.pkix_verify_hostname(der, dns_id: ~c"lab1")
      true
  """
  @spec issue_pem(String.t(), keyword()) :: %{
          certificate: String.t(),
          key: String.t(),
          authority: String.t()
        }
  def issue_pem(name, opts \\ []) do
    today = Date.utc_today()
    until = Date.add(today, Keyword.get(opts, :days, @days))
    validity = {Date.to_erl(Date.add(today, -1)), Date.to_erl(until)}
    common = [digest: :sha256, key: {:namedCurve, :secp256r1}, validity: validity]
    root = :public_key.pkix_test_root_cert(~c"authority", common)
    peer = common ++ [extensions: alternative_names(Keyword.get(opts, :hosts, []))]
    chain = %{root: root, intermediates: [], peer: peer}
    test_data = :public_key.pkix_test_data(chain)
    {kind, key} = test_data[:key]
    issuer = name <> ", authority"

    %{
      certificate:
        encode_pem(:Certificate, rename_and_sign(test_data[:cert], name, issuer, root.key)),
      key: encode_pem(kind, key),
      authority: encode_pem(:Certificate, rename_and_sign(root.cert, issuer, issuer, root.key))
    }
  end

  defp alternative_names([]), do: []

  defp alternative_names(hosts) do
    names = Enum.map(hosts, &general_name/1)
    [extension(extnID: @subject_alternative_name, extnValue: names)]
  end

  # Erlang's test certificates have a fixed subject ("automated testing").
  defp rename_and_sign(der, subject, issuer, key) do
    certificate(tbsCertificate: tbs) = :public_key.pkix_decode_cert(der, :otp)
    {:rdnSequence, sequence} = tbs(tbs, :subject)
    common = sequence |> List.flatten() |> Enum.find(&(elem(&1, 1) == @common_name))
    rdn = fn name -> {:rdnSequence, [[put_elem(common, 2, {:utf8String, name})]]} end
    :public_key.pkix_sign(tbs(tbs, subject: rdn.(subject), issuer: rdn.(issuer)), key)
  end

  defp general_name(host) do
    case host |> String.to_charlist() |> :inet.parse_address() do
      {:ok, {a, b, c, d}} ->
        {:iPAddress, <<a, b, c, d>>}

      {:ok, address} ->
        {:iPAddress, for(word <- Tuple.to_list(address), into: <<>>, do: <<word::16>>)}

      {:error, _} ->
        {:dNSName, String.to_charlist(host)}
    end
  end

  defp encode_pem(kind, der), do: :public_key.pem_encode([{kind, der, :not_encrypted}])

  defp usable_for?(tls, hosts) do
    with {:ok, text} <- File.read(tls[:certfile]),
         true <- File.exists?(tls[:keyfile]),
         {:ok, der} <- first_certificate(text),
         {:ok, tbs} <- decode_certificate(der) do
      valid_long_enough?(tbs) and Enum.all?(hosts, &(general_name(&1) in certified_names(tbs)))
    else
      _ -> false
    end
  end

  defp first_certificate(text) do
    [{:Certificate, der, :not_encrypted} | _] = :public_key.pem_decode(text)
    {:ok, der}
  rescue
    _ -> :error
  end

  # A certificate that cannot be decoded is issued again: it may be damaged, or this version of Erlang may not support
  # it.
  defp decode_certificate(der) do
    certificate(tbsCertificate: tbs) = :public_key.pkix_decode_cert(der, :otp)
    {:ok, tbs}
  rescue
    _ -> :error
  end

  defp certified_names(tbs) do
    for extension(extnID: @subject_alternative_name, extnValue: names) <- tbs(tbs, :extensions),
        name <- names,
        do: name
  end

  defp valid_long_enough?(tbs) do
    {:Validity, _from, until} = tbs(tbs, :validity)
    days = fn {{_, _, _} = date, _time} -> :calendar.date_to_gregorian_days(date) end
    days.(parse_time(until)) - days.(:calendar.universal_time()) > @renew_days
  end

  defp parse_time({:utcTime, text}),
    do: text |> to_string() |> then(&("20" <> &1)) |> parse_date()

  defp parse_time({:generalTime, text}), do: text |> to_string() |> parse_date()

  defp parse_date(<<y::binary-4, m::binary-2, d::binary-2, _::binary>>),
    do: {{String.to_integer(y), String.to_integer(m), String.to_integer(d)}, {0, 0, 0}}
end
