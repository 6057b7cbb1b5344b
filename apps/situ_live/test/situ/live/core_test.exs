defmodule Situ.Live.CoreTest do
  # The pure parts: diff flow control, tokens, queries and routes.
  use ExUnit.Case, async: true
  alias Situ.JSON
  alias Situ.Live.{DiffPacing, ViewLifecycle, Query, Request, Route, Token}

  describe "Flow" do
    test "one diff is in flight until it is acknowledged or timed out" do
      flow = DiffPacing.new(ack?: true)
      assert DiffPacing.time_to_send(flow, 0) == :now
      flow = DiffPacing.record_sent(flow, 0)
      assert DiffPacing.time_to_send(flow, 100) == {:wait, 4_900}
      assert DiffPacing.time_to_send(flow, 5_000) == :now
      assert DiffPacing.time_to_send(DiffPacing.record_ack(flow), 10) == {:wait, 23}
      assert DiffPacing.time_to_send(DiffPacing.record_ack(flow), 33) == :now
    end

    test "a page that does not acknowledge is limited to the interval" do
      flow = DiffPacing.record_sent(DiffPacing.new(ack?: false), 0)
      assert DiffPacing.time_to_send(flow, 10) == {:wait, 23}
      assert DiffPacing.time_to_send(flow, 33) == :now
    end
  end

  describe "Page.event_params/3" do
    test "names the changed field by its path, as the browser sends its name" do
      assert ViewLifecycle.event_params("form", "props[width]=2", %{"_target" => "props[width]"}) ==
               {:ok, %{"props" => %{"width" => "2"}, "_target" => ["props", "width"]}}

      assert ViewLifecycle.event_params("form", "a=1", %{"_target" => "a"}) ==
               {:ok, %{"a" => "1", "_target" => ["a"]}}
    end

    test "omits an invalid name" do
      deep = "a" <> String.duplicate("[b]", 9)

      for target <- [7, nil, deep],
          do:
            assert(
              ViewLifecycle.event_params("form", "a=1", %{"_target" => target}) ==
                {:ok, %{"a" => "1"}}
            )
    end
  end

  describe "Token" do
    test "no changed token verifies" do
      token = Token.sign("secret", "salt", %{"a" => 1})
      assert {:ok, %{"a" => 1}} = Token.verify("secret", "salt", token, 60)

      for at <- 0..(byte_size(token) - 1) do
        <<left::binary-size(at), c, right::binary>> = token
        changed = left <> <<Bitwise.bxor(c, 1)>> <> right
        assert {:error, :bad_token} = Token.verify("secret", "salt", changed, 60)
      end
    end

    test "rejects another salt, an expired token and invalid tokens" do
      token = Token.sign("secret", "salt", 1, 1_000)
      assert {:error, :bad_token} = Token.verify("secret", "other", token, 60, 1_000)
      assert {:ok, 1} = Token.verify("secret", "salt", token, 60, 1_060)
      assert {:error, :expired} = Token.verify("secret", "salt", token, 60, 1_061)

      for bad <- [nil, "", ".", "a.b", 7, %{}, String.duplicate("x", 10_000)],
          do: assert({:error, :bad_token} = Token.verify("secret", "salt", bad, 60, 1_000))
    end
  end

  describe "Query" do
    test "decodes its own output, and any text without raising" do
      key = :proper_types.elements(["a", "b c", "é"])
      leaf = :proper_types.elements(["", "x y", "&=%", "[é]"])
      list = :proper_types.non_empty(:proper_types.list(leaf))
      inner = :proper_types.list({key, :proper_types.oneof([leaf, list])})
      outer = :proper_types.list({key, :proper_types.oneof([leaf, inner])})

      round_trip =
        :proper.forall(outer, fn pairs ->
          map =
            for {k, v} <- pairs, into: %{} do
              {k, if(match?([{_, _} | _], v), do: Map.new(v), else: v)}
            end

          map = Map.reject(map, fn {_, v} -> v == [] end)
          Query.parse(Query.encode(map)) == {:ok, map}
        end)

      assert :proper.quickcheck(round_trip, [:quiet, numtests: 300]) == true

      any =
        :proper.forall(:proper_types.binary(), fn bytes ->
          match?({_, _}, Query.parse(bytes)) and match?({_, _}, JSON.decode(bytes))
        end)

      assert :proper.quickcheck(any, [:quiet, numtests: 500]) == true
    end

    test "limits fields and depth" do
      assert {:error, :bad_query} = Query.parse(String.duplicate("a=1&", 1_001))
      assert {:error, :bad_query} = Query.parse("a" <> String.duplicate("[b]", 20) <> "=1")
    end
  end

  describe "Route and Request" do
    test "rejects invalid paths before routing" do
      for path <- ["/a/../b", "/%2e%2e/x", "/a%2fb", "/a%00", "/%ff", "a", "/a%5cb", "/a%0d%0ab"] do
        assert {:error, :bad_request} = Request.new("GET", path, %{})
      end

      assert {:ok, %{segments: ["é", "a b"]}} = Request.new("GET", "/%C3%A9//a%20b?x=1", %{})
    end

    test "the method selects among routes of a path" do
      handler = &Function.identity/1
      routes = Route.compile([{:get, "/a", handler}, {:post, "/a", handler}])

      assert {:ok, %{methods: ["POST"]}, _} =
               Route.match_request(routes, %Request{method: "POST", segments: ["a"]})

      assert {:ok, %{methods: ["GET"]}, _} =
               Route.match_request(routes, %Request{method: "HEAD", segments: ["a"]})

      assert {:error, {:method, ["GET", "POST"]}} =
               Route.match_request(routes, %Request{method: "PUT", segments: ["a"]})

      assert {:error, :not_found} = Route.match_request(routes, %Request{segments: ["b"]})
    end

    test "an invalid route raises" do
      for bad <- [:x, {:get, "a", &Function.identity/1}, {:get, "/a", :x}, {:live, "/", Enum}],
          do: assert_raise(ArgumentError, fn -> Route.compile([bad]) end)
    end
  end
end
