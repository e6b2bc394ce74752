// The token leaves the address bar and the history; the view behind the # stays.
location.replace(`/${location.hash}`);
