defmodule Situ.Live.ViewTest do
  # Views in the test client, without a browser or a server.
  use ExUnit.Case, async: true
  alias Situ.Live.Demo.{Main, Other, Raises}
  alias Situ.Live.Test, as: Page
  import ExUnit.CaptureLog

  defp page(opts \\ []), do: Page.mount(Main, opts)

  test "clicks change branches and attributes" do
    page = page()
    assert Page.text(page, "#count") == "0"
    assert Page.page_title(page) == "demo"
    assert :ok = Page.click(page, "#inc")
    assert Page.text(page, "#count") == "1"
    assert Page.has_element?(page, "#closed")
    Page.click(page, "#toggle")
    refute Page.has_element?(page, "#closed")
    assert Page.text(page, "#open b") == "odd"
    Page.click(page, "#dis")
    assert_raise ArgumentError, ~r/is disabled/, fn -> Page.click(page, "#inc") end
    Page.click(page, "#js")
    assert Page.text(page, "#count") == "2"
  end

  test "updates a keyed list with an island that shows part of it" do
    page = page()
    Page.click(page, "#rev")
    Page.click(page, "#add")
    Page.click(page, "#r3 [phx-click=bump]")
    Page.click(page, "#r5 [phx-click=del]")
    assert Page.count_elements(page, "#list li") == 5
    assert Page.get_attribute(page, "#r3", "class") == "hot"
    assert Page.get_attribute(page, "#r4", "class") == ""
    assert Page.count_elements(page, "#island tbody tr") == 3
    assert Page.text(page, "#t-4 td") == "row 4"
  end

  test "handles forms with nested fields, and escapes the input" do
    page = page()
    Page.change(page, "#f", %{"f" => %{"q" => "a<b>&\"é"}}, target: ["f", "q"])
    assert Page.text(page, "#note") == "len 7"
    assert Page.get_attribute(page, "#q", "value") == "a<b>&\"é"
    assert Page.render(page) =~ "a&lt;b&gt;&amp;&quot;é"
    Page.submit(page, "#f", %{"f" => %{"q" => "x"}})
    assert Page.text(page, "#note") == "saved x"
  end

  test "hooks receive replies, pushed events and events of the mount" do
    page = page()
    assert Page.take_pushed_events(page, "points") == [%{"pts" => 1}]
    assert {:ok, %{"echo" => %{"a" => 1}}} = Page.send_event(page, "ask", %{a: 1})
    Page.send_event(page, "draw", %{n: 7})
    assert Page.take_pushed_events(page, "points") == [%{"pts" => 7}]
  end

  test "streams: the server forgets the rows, the page keeps them" do
    page = page()
    assert Page.count_elements(page, "#lines li") == 2
    Page.click(page, "#line")
    Page.click(page, "#unline")
    assert Page.text(page, "#lines") == "threetwo"
    assert :sys.get_state(page.view).socket.assigns.streams.lines.inserts == []
    Page.click(page, "#relines")
    assert Page.text(page, "#lines") == "nine"
  end

  test "patches and navigates" do
    page = page(path: "/?tab=b")
    assert Page.text(page, "#tab") == "b"
    Page.click(page, "#patch")
    assert Page.text(page, "#tab") == "c"
    assert Page.list_visits(page) == [{:live_patch, "/?tab=c"}]
    Page.patch(page, "/?tab=d")
    assert Page.text(page, "#tab") == "d"
    assert {:ok, %{"link_redirect" => true}} = Page.patch(page, "/elsewhere")
    assert {:ok, %{"live_redirect" => "/other"}} = Page.click(page, "#lr")
    Page.click(page, "#go")
    assert {:live_redirect, "/other"} in Page.list_visits(page)
  end

  test "messages update the page with escaped content" do
    page = page(session: %{"user" => "ann"})
    assert Page.text(page, "#user") == "ann"
    Page.send_info(page, {:set, :nasty, "<script>alert(1)</script>"})
    refute Page.render(page) =~ "<script>"
    assert Page.text(page, "#nasty") == "<script>alert(1)</script>"
  end

  test "diffs still arrive without acknowledgements" do
    page = page(connect_params: %{})
    Page.send_info(page, {:set, :tick, 5})
    assert Page.text(page, "#tick") == "5"
  end

  test "a view that raises dies alone and keeps its assigns out of the log" do
    page = page(session: %{"user" => "secret-user"})
    other = page()

    log =
      capture_log(fn ->
        assert {:error, {:view_down, {:shutdown, :crashed}}} = Page.click(page, "#crash")
      end)

    assert log =~ "boom"
    refute log =~ "secret-user"
    refute Page.alive?(page)
    assert Page.text(other, "#count") == "0"
  end

  test "a mount that raises is reported" do
    capture_log(fn ->
      assert_raise RuntimeError, ~r/join crashed/, fn -> Page.mount(Raises) end
    end)
  end

  test "malformed messages are rejected, and the view survives" do
    page = page()

    for {event, payload} <- [
          {"event", nil},
          {"event", %{}},
          {"event", %{"event" => 7, "type" => "click"}},
          {"event", %{"event" => "form", "type" => "form", "value" => "a=%ff"}},
          {"live_patch", %{}},
          {"cids_destroyed", %{"cids" => "all"}},
          {"no such thing", %{}}
        ] do
      assert {:error, _} = Page.push_message(page, event, payload)
    end

    for url <- [3, nil, "\0"] do
      assert {:ok, %{"link_redirect" => true}} =
               Page.push_message(page, "live_patch", %{"url" => url})
    end

    assert Page.text(page, "#count") == "0"
  end

  test "confirms removed islands only" do
    page = page()

    assert {:ok, %{"cids" => [99]}} =
             Page.push_message(page, "cids_destroyed", %{"cids" => [1, 99]})
  end

  test "a static view renders" do
    assert Page.text(Page.mount(Other), "#other") == "other"
  end
end
