defmodule Situ.Bridge.Ros.XmlRpc do
  @moduledoc false
  # Speaks XML-RPC (http://xmlrpc.com/spec.md) with ROS's master and nodes. Parsing creates no atoms, resolves only the
  # five entities of XML, and is bounded by the size of the input. Pure, except for `call/4`.
  alias Situ.Error

  @type value ::
          integer()
          | float()
          | boolean()
          | String.t()
          | [value()]
          | %{String.t() => value()}
          | nil
          | {:bytes, binary()}

  @deepest 64

  @doc "Encodes the document of a call."
  @spec request(String.t(), [value()]) :: iodata()
  def request(method, arguments) do
    [~s(<?xml version="1.0"?><methodCall><methodName>), method, "</methodName><params>"] ++
      [for(a <- arguments, do: ["<param>", write(a), "</param>"]), "</params></methodCall>"]
  end

  @doc "Encodes the document of a response."
  @spec response(value()) :: iodata()
  def response(value),
    do: [
      ~s(<?xml version="1.0"?><methodResponse><params><param>),
      write(value),
      "</param></params></methodResponse>"
    ]

  defp write(value), do: ["<value>", body(value), "</value>"]

  defp body(true), do: "<boolean>1</boolean>"
  defp body(false), do: "<boolean>0</boolean>"
  defp body(nil), do: "<nil/>"
  defp body(n) when is_integer(n), do: ["<int>", Integer.to_string(n), "</int>"]
  defp body(x) when is_float(x), do: ["<double>", Float.to_string(x), "</double>"]
  defp body(text) when is_binary(text), do: ["<string>", escaped(text), "</string>"]
  defp body({:bytes, bytes}), do: ["<base64>", Base.encode64(bytes), "</base64>"]

  defp body(list) when is_list(list),
    do: ["<array><data>", Enum.map(list, &write/1), "</data></array>"]

  defp body(map) when is_map(map) do
    members =
      for {k, v} <- map,
          do: ["<member><name>", escaped(to_string(k)), "</name>", write(v), "</member>"]

    ["<struct>", members, "</struct>"]
  end

  defp escaped(text) do
    text
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
  end

  @doc """
  Parses the document of a call and returns its method and arguments.

      iex> alias Situ.Bridge.Ros.XmlRpc
      iex> XmlRpc.read_request(IO.iodata_to_binary(XmlRpc.request("getPid", ["/me", [1, %{"a" => true}]])))
      {:ok, "getPid", ["/me", [1, %{"a" => true}]]}
  """
  @spec read_request(binary()) :: {:ok, String.t(), [value()]} | {:error, String.t()}
  def read_request(document) do
    with {:ok, {"methodCall", children}} <- tree(document),
         [{"methodName", [method]} | rest] when is_binary(method) <- elements(children) do
      {:ok, String.trim(method), params(rest)}
    else
      {:error, why} -> {:error, why}
      _ -> {:error, "the document is not a call"}
    end
  catch
    {:not_xml_rpc, why} -> {:error, why}
  end

  @doc "Parses the document of a response and returns its value. A fault is an error."
  @spec read_response(binary()) :: {:ok, value()} | {:error, String.t()}
  def read_response(document) do
    with {:ok, {"methodResponse", children}} <- tree(document) do
      case elements(children) do
        [{"fault", fault} | _] ->
          {:error,
           "the server refused: #{inspect(params([{"params", [{"param", fault}]}]), limit: 20)}"}

        children ->
          answer(params(children))
      end
    else
      {:error, why} -> {:error, why}
      _ -> {:error, "the document is not a response"}
    end
  catch
    {:not_xml_rpc, why} -> {:error, why}
  end

  defp answer([value]), do: {:ok, value}
  defp answer(_), do: {:error, "the response does not have exactly one value"}

  defp params([{"params", params}]) do
    for {"param", children} <- params do
      case elements(children) do
        [value] -> value(value)
        _ -> fail("a parameter does not have exactly one value")
      end
    end
  end

  defp params([]), do: []
  defp params(_), do: fail("the document has no params")

  defp value({"value", []}), do: ""
  defp value({"value", [text]}) when is_binary(text), do: text

  defp value({"value", children}) do
    case Enum.reject(children, &(is_binary(&1) and String.trim(&1) == "")) do
      [typed] -> typed(typed)
      _ -> fail("a value does not have exactly one element")
    end
  end

  defp value(_other), do: fail("an element is not a value")

  defp typed({int, [text]}) when int in ["int", "i4", "i8"] and is_binary(text) do
    case Integer.parse(String.trim(text)) do
      {n, ""} -> n
      _ -> fail("an integer is invalid")
    end
  end

  defp typed({"double", [text]}) when is_binary(text) do
    case Float.parse(String.trim(text)) do
      {x, ""} -> x
      _ -> fail("a floating-point number is invalid")
    end
  end

  defp typed({"boolean", [text]}) when is_binary(text), do: String.trim(text) == "1"
  defp typed({"nil", []}), do: nil
  defp typed({"string", children}), do: children |> Enum.filter(&is_binary/1) |> Enum.join()

  defp typed({"base64", children}) do
    case children
         |> Enum.filter(&is_binary/1)
         |> Enum.join()
         |> Base.decode64(ignore: :whitespace) do
      {:ok, bytes} -> {:bytes, bytes}
      :error -> fail("base64 data is invalid")
    end
  end

  defp typed({"array", children}) do
    case elements(children) do
      [{"data", values}] -> Enum.map(elements(values), &value/1)
      _ -> fail("an array has no data")
    end
  end

  defp typed({"struct", members}) do
    for {"member", children} <- elements(members), into: %{} do
      case elements(children) do
        [{"name", name}, value] ->
          {name |> Enum.filter(&is_binary/1) |> Enum.join(), value(value)}

        _ ->
          fail("a member of a struct does not have a name and a value")
      end
    end
  end

  defp typed(text) when is_binary(text), do: text
  defp typed({name, _}), do: fail("a value has the unknown type #{inspect(name)}")

  defp elements(children), do: Enum.reject(children, &is_binary/1)
  defp fail(why), do: throw({:not_xml_rpc, why})

  # Parses elements as `{name, children}`. The declaration and comments are skipped.

  defp tree(document) do
    text = Regex.replace(~r/<\?.*?\?>|<!--.*?-->/s, document, "")

    case text |> String.trim() |> element(0) do
      {element, rest} ->
        if String.trim(rest) == "",
          do: {:ok, element},
          else: {:error, "the document has text after its last element"}
    end
  catch
    {:not_xml_rpc, why} -> {:error, why}
  end

  @open ~r/\A<([A-Za-z0-9]{1,40})\s*(\/?)>/

  defp element(_text, depth) when depth > @deepest, do: fail("the document is nested too deeply")

  defp element(text, depth) do
    case Regex.run(@open, text, return: :index) do
      [{0, n}, {at, length}, {_, closed}] ->
        name = binary_part(text, at, length)
        rest = binary_part(text, n, byte_size(text) - n)
        if closed == 1, do: {{name, []}, rest}, else: children(rest, name, depth, [])

      _ ->
        fail("the document is not valid XML-RPC")
    end
  end

  defp children(text, name, depth, found) do
    case :binary.split(text, "<") do
      ["", <<"/", _::binary>>] -> {{name, Enum.reverse(found)}, closed(text, name)}
      ["", _] -> text |> element(depth + 1) |> next(name, depth, found)
      [words, rest] -> children("<" <> rest, name, depth, word(words, found))
      [_] -> fail("the document is cut short")
    end
  end

  defp next({child, rest}, name, depth, found), do: children(rest, name, depth, [child | found])

  # Between the elements of a structure there is only whitespace.
  defp word(words, found) do
    if found != [] and String.trim(words) == "", do: found, else: [unescaped(words) | found]
  end

  defp closed(text, name) do
    case Regex.run(~r/\A<\/([A-Za-z0-9]+)\s*>/, text) do
      [all, ^name] -> binary_part(text, byte_size(all), byte_size(text) - byte_size(all))
      _ -> fail("the element #{name} is not closed")
    end
  end

  defp unescaped(text) do
    Regex.replace(~r/&(amp|lt|gt|quot|apos);/, text, fn _, name ->
      %{"amp" => "&", "lt" => "<", "gt" => ">", "quot" => "\"", "apos" => "'"}[name]
    end)
  end

  @doc "Calls a method of a server and returns its value. Errors: `:ros_unreachable`, `:ros_refused`."
  @spec call(String.t(), String.t(), [value()], timeout :: pos_integer()) ::
          {:ok, value()} | {:error, Error.t()}
  def call(uri, method, arguments, timeout \\ 3_000) do
    body = IO.iodata_to_binary(request(method, arguments))
    headers = [{~c"connection", ~c"close"}, {~c"user-agent", ~c"situ"}]
    http = [timeout: timeout, connect_timeout: timeout, autoredirect: false]
    request = {String.to_charlist(uri), headers, ~c"text/xml", body}

    with {:ok, {{_, 200, _}, _, answer}} <-
           :httpc.request(:post, request, http, body_format: :binary),
         {:ok, value} <- read_response(answer) do
      {:ok, value}
    else
      {:ok, {{_, status, _}, _, _}} -> {:error, refused(uri, method, "HTTP status #{status}")}
      {:error, why} when is_binary(why) -> {:error, refused(uri, method, why)}
      {:error, reason} -> {:error, unreachable(uri, reason)}
    end
  end

  defp refused(uri, method, why),
    do: Error.new(:ros_refused, "#{uri} refused #{method}", why: why)

  defp unreachable(uri, reason) do
    Error.new(:ros_unreachable, "no response from #{uri}",
      why: inspect(reason, limit: 10),
      fix: "start it (`rosmaster --core`), or give its address with `master:` or ROS_MASTER_URI"
    )
  end
end
